"""State of a controller: all values that the interfaces show, and all values that programs change.

The state is one passive object that does not depend on programs or interfaces. The control loop advances it. The
interfaces make their packets and messages from the state.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

from linkcore.errors import BadValue
from urlink.arm.kinematics import Arm as Kinematics
from urlink.arm.models import Model
from urlink.protocol.enums import ControlMode, ProgramState, TimeScaleSource
from urlink.protocol.firmware import Firmware, existing_firmware

from .registers import InputClaims, RegisterBanks, Watchdogs
from .robot.arm import SimulatedArm
from .robot.characteristics import ScalingParameters, approached
from .robot.generator import ArmDrive
from .robot.modes import Modes, StopState
from .robot.setpoint_sources import Setpoint, SetpointSource
from .robot.signals import ModbusSignals, Signals
from .robot.surroundings import Surroundings

if TYPE_CHECKING:
    from urlink.arm.arm_file import ArmFile

#: Number of bytes of messages in one cycle above which texts and popups are dropped. A program could make thousands of
#: texts and popups in one cycle.
MOST_MESSAGES = 1 << 14
#: Number of flags for `set_flag` and `get_flag`. It is inferred that the highest flag is 31
#: (docs/protocols/urscript.md, Flags).
FLAGS = 32


@dataclass
class Counters:
    """Counters of events on a controller's interfaces since the controller was made.

    Attributes:
        connections: Accepted connections.
        sent: Packets and packages passed to the network, counted once per connection.
        dropped: Connections that were ended because the client did not read.
        unread: Packets that were dropped because the client had not read the previous ones.
        refused_bytes: Discarded input bytes: text to read-only ports, lines and programs that are too long, and
            programs that exceed the limit of the queue.
        refused_programs: Programs and lines that were ignored because of the state of the controller.
        late: Cycles whose packets were sent more than one cycle after they were due.
        skipped: Cycles whose packets were not sent because they were far too late.
        lost_messages: Dropped messages. They are texts and popups of programs above the limit of one cycle. On a
            stepped controller, they are also messages above the maximum number that is stored until `take_messages` is
            called.
        ignored_packages: Invalid packages from RTDE clients, such as data of an unknown recipe.
    """

    connections: int = 0
    sent: int = 0
    dropped: int = 0
    unread: int = 0
    refused_bytes: int = 0
    refused_programs: int = 0
    late: int = 0
    skipped: int = 0
    lost_messages: int = 0
    ignored_packages: int = 0


class StopCause(NamedTuple):
    """Cause of a change of the safety mode.

    Attributes:
        reason: Reason that the message of the stop shows; "" if no reason was given.
        by_program: Whether a program has called `protective_stop()`.
        code: Number and argument of the code that the message of the stop shows; None for the default.
    """

    reason: str = ""
    by_program: bool = False
    code: tuple[int, int] | None = None


_NO_CAUSE = StopCause()


class StateOutbox:
    """Queue of robot messages for the clients of the primary interface.

    Args:
        counters: Counters to which dropped messages are added.
    """

    def __init__(self, counters: Counters) -> None:
        self._counters = counters
        self._messages: list[bytes] = []
        self._size = 0

    def put(self, message: bytes) -> None:
        """Add a message that is always sent."""
        self._messages.append(message)
        self._size += len(message)

    def offer(self, make: Callable[[], bytes]) -> None:
        """Make and add a message, or drop it if the queue is already too long."""
        if self._size > MOST_MESSAGES:
            self._counters.lost_messages += 1
        else:
            self.put(make())

    @property
    def is_empty(self) -> bool:
        """Whether there is no message."""
        return not self._messages

    def take(self) -> list[bytes]:
        """Return and remove all messages."""
        messages, self._messages, self._size = self._messages, [], 0
        return messages


class ControllerState:
    """State of a controller.

    Args:
        kinematics: Kinematics of the arm.
        firmware: Firmware until the first reboot. Its rate is the number of cycles per second, also after a reboot.
        source: Source of set-points that the arm follows after each start of the controller.
        serial: Serial number of the arm.
        seed: Seed of the sensor noise.
        noise: Whether the sensors are noisy.
        scaling_parameters: Parameters of the speed scaling.
        zeroes_force: Whether the start of a program zeroes the force sensor.
        like: Identified properties of an arm. None selects the known properties of the model.

    Attributes:
        kinematics, serial: See the arguments with the same names.
        firmware: Current firmware.
        rate: Cycles per second.
        period: Duration of a cycle, in s.
        cycle: Number of cycles since the controller was made, including reboots.
        uptime: Number of cycles since the controller came up.
        cycles_down: Number of cycles until the current reboot is complete; 0 while the controller is up.
        surroundings: Objects that the tool touches. They persist across reboots.
        arm: Joints, tool and sensors.
        modes: Robot mode, safety mode and program state.
        signals: Inputs and outputs.
        modbus: Modbus signals by name; there is no simulated bus.
        registers: General-purpose registers. A reboot clears them (assumed).
        watchdogs: Watchdogs that the running program has set for RTDE inputs.
        rtde_inputs: Name -> last value that a client has sent.
        claims: RTDE inputs, and the clients that have claimed them.
        fieldbus: Fieldbus that is enabled in the installation, a key of `FIELDBUSES`, or None.
        source: Current source of the arm's set-points.
        is_paused: Whether the source is paused, because its program was paused on the pendant or by a stop.
        resumes: Whether the program continues automatically when the current stop has ended.
        by_hand: Drive with which the pendant moves the arm while no program plays; None if the pendant does not move
            it.
        speed_fraction: Position of the speed slider, 0 to 1.
        slider: Fraction of the speed slider that takes effect; it approaches `speed_fraction` gradually.
        scaling: Speed at which the commands of programs are executed, as a fraction of the commanded speed. It
            approaches `slider`, and is 0 at the start of a program.
        scaling_parameters, zeroes_force: See the arguments of the same names.
        remote_control: Whether an e-Series is in remote control.
        has_local_control: Whether an e-Series in local control rejects commands that do not come from the pendant.
        control_mode: Quantity that the running program controls; position if there is no program.
        teach_button: Whether the freedrive button is pressed.
        flags: Flags that programs set with `set_flag`.
        stopped_since: `time` at which the current stop began; None if there is no stop.
        popup: Text that the pendant shows, or None.
        loaded: Path of the program that `play` runs, or None.
        log: Lines that the dashboard has added.
        counters: Counters of events on the interfaces.
        outbox: Messages to be sent.
    """

    def __init__(
        self,
        kinematics: Kinematics,
        firmware: Firmware,
        source: SetpointSource,
        *,
        serial: str,
        seed: int,
        noise: bool,
        scaling_parameters: ScalingParameters,
        zeroes_force: bool = False,
        like: ArmFile | None = None,
    ) -> None:
        self.kinematics = kinematics
        self.scaling_parameters = scaling_parameters
        self.zeroes_force = zeroes_force
        self.serial = serial
        self._noise_seed = seed if noise else None
        self.cycle = 0
        self.cycles_down = 0
        self.signals = Signals()
        self.modbus = ModbusSignals(lambda: self.time)
        self.remote_control = self.has_local_control = True
        self.teach_button = False
        self.fieldbus: str | None = None
        self.log: list[str] = []
        self.counters = Counters()
        self.outbox = StateOutbox(self.counters)
        self.surroundings = Surroundings()
        self._like = like
        self._first_source = source
        self._next_firmware = firmware
        self.arm = self._make_arm()
        self._begin()

    def _begin(self) -> None:
        self.firmware = firmware = self._next_firmware
        self.rate, self.period = firmware.rate, 1.0 / firmware.rate
        self.source = self._first_source
        self.uptime = 0
        self.modes = Modes(firmware)
        self.is_paused = self.resumes = False
        self.by_hand: ArmDrive | None = None
        self.control_mode = ControlMode.POSITION
        self.speed_fraction = self.slider = 1.0
        self.scaling = 0.0
        self.flags = [False] * FLAGS
        self.registers = RegisterBanks()
        self.watchdogs = Watchdogs()
        self.rtde_inputs: dict[str, Any] = {}
        self.claims = InputClaims()
        self.stopped_since: float | None = None
        self.popup: str | None = None
        self.loaded: str | None = None
        self._stop_cause = _NO_CAUSE
        self._announced = self.modes.safety_mode
        self.update_modes(0.0)

    def _make_arm(self) -> SimulatedArm:
        setpoint = self._first_source.advance(0.0)
        is_cb2 = self._next_firmware.is_cb2
        return SimulatedArm(self.kinematics, setpoint, self._noise_seed, self.surroundings, self._like, is_cb2)

    def go_down(self, firmware: Firmware | None, seconds: float) -> None:
        """Reboot: shut down for a time, then start with this firmware, or with the current one if it is None.

        The controller is down for at least one cycle.

        Without power, the brakes hold the joints. The small distance that the joints move before the brakes engage is
        not modelled.
        """
        self.cycles_down = max(1, math.ceil(seconds * self.rate))
        self._next_firmware = self.firmware if firmware is None else firmware.at(self.rate)
        self.outbox.take()
        self.arm.advance(self.period, Setpoint(self.arm.setpoint.q, [0.0] * 6, [0.0] * 6))

    def come_up(self) -> None:
        """Complete the reboot.

        The arm has not moved. TCP and payload are kept, because they are stored in the installation. It is assumed that
        the popup and the loaded program are lost, and that signals, remote control and log are kept.
        """
        before = self.arm
        self._first_source.start(before.setpoint.q)
        self.arm = self._make_arm()
        self.arm.take_tool_of(before)
        self._begin()

    # -- time ----------------------------------------------------------------------------------------

    @property
    def model(self) -> Model:
        """Model of the arm: its published geometry, limits and masses."""
        return self.kinematics.model

    @property
    def time(self) -> float:
        """Time since the controller came up, in s: a whole number of cycles."""
        return self.uptime / self.rate

    def time_of(self, cycle: int) -> float:
        """Return `time` in a cycle since the controller came up, in s."""
        return (self.uptime - self.cycle + cycle) / self.rate

    @property
    def is_up(self) -> bool:
        """Whether the controller is up; False during a reboot."""
        return self.cycles_down == 0

    @property
    def is_local(self) -> bool:
        """Whether only the pendant can command the controller, because it is an e-Series in local control."""
        return self.firmware.is_e_series and self.has_local_control and not self.remote_control

    def move_slider(self, seconds: float) -> None:
        """Move `slider` towards `speed_fraction`, at the limited rate of the slider, for this number of seconds."""
        if self.slider != self.speed_fraction:
            self.slider = approached(self.slider, self.speed_fraction, self.scaling_parameters.slider_rate * seconds)

    @property
    def speed_scaling(self) -> float:
        """Speed scaling that all interfaces show, which is `slider` while a program plays.

        The start of a program does not affect this value. In the log of a UR3e, the value is 1 while the joints still
        accelerate.
        """
        return self.modes.speed_scaling * self.slider

    @property
    def time_scale_source(self) -> TimeScaleSource:
        """Reason for which the speed of the motion is scaled.

        It is assumed that a change of the slider, and the start of a program, count as a smooth transition.
        """
        if self.modes.program_state is not ProgramState.PLAYING:
            return TimeScaleSource.PROGRAM_NOT_RUNNING
        is_changing = self.slider != self.speed_fraction or self.scaling != self.slider
        return TimeScaleSource.SMOOTH_TRANSITION if is_changing else TimeScaleSource.NOT_SCALED

    # -- modes ---------------------------------------------------------------------------------------

    def update_modes(self, seconds: float) -> None:
        """Update the modes from the states of the arm and the program, `seconds` after the last update."""
        is_standing = self.arm.is_standing or self.by_hand is not None
        self.modes.advance(seconds, is_standing, self.source.is_program, self.is_paused)

    def stop_protectively(self, reason: str, *, by_program: bool = False, code: tuple[int, int] | None = None) -> None:
        """Make a protective stop.

        Args:
            reason: Reason that the message of the stop shows.
            by_program: Whether a program has requested the stop.
            code: Number and argument of the code that the message of the stop shows; None for the default.
        """
        self._stop_cause = StopCause(reason, by_program, code)
        self.modes.protective_stop()

    @property
    def has_safety_change(self) -> bool:
        """Whether the safety mode has changed since the last call of `take_safety_change`."""
        return self.modes.safety_mode is not self._announced

    def take_safety_change(self) -> StopCause | None:
        """Return the cause of a change of the safety mode since the last call; None if unchanged."""
        cause, self._stop_cause = self._stop_cause, _NO_CAUSE
        modes = self.modes
        if not self.has_safety_change:
            return None
        self._announced = modes.safety_mode
        self.stopped_since = None if modes.stop is StopState.NONE else self.time
        return cause if modes.stop is StopState.PROTECTIVE else _NO_CAUSE


def firmware_for(model: Model, firmware: str | Firmware) -> Firmware:
    """Return the firmware if it runs on the model.

    UR3, UR5 and UR10 run 3.x. UR5 and UR10 also run 1.x. The UR3 does not, because it was introduced with CB3. All
    other arms run 5.0 and later. It is not checked whether a newer arm needs a later release than 5.0.

    Raises:
        BadVersion: If there is no such firmware.
        BadValue: If the firmware does not run on the model.
    """
    parsed = existing_firmware(firmware)
    if model.generation == "e":
        suits, needs = parsed.is_e_series, "5.0 or later"
    elif model.name == "UR3":
        suits, needs = not parsed.is_e_series and not parsed.is_cb2, "3.x"
    else:
        suits, needs = not parsed.is_e_series, "1.x or 3.x"
    if not suits:
        raise BadValue(f"a {model.name} does not run firmware {parsed}; expected {needs}")
    return parsed

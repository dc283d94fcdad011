"""The state of a controller: everything that its interfaces show and its programs change, in one passive object.

It does not depend on programs or interfaces. The control loop advances it; packets and messages are made from it.
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

#: Bytes of messages in one cycle above which texts and popups are lost; a program could make thousands of them.
MOST_MESSAGES = 1 << 14
#: Flags of `set_flag` and `get_flag`: that their numbers go up to 31 is inferred (docs/protocols/urscript.md, Flags).
FLAGS = 32


@dataclass
class Counters:
    """Counters of a controller's interfaces, since it was made.

    Attributes:
        connections: accepted.
        sent: packets and packages handed to the network, once per connection.
        dropped: connections ended because the client did not read.
        unread: packets that were left out because the client had not read those before.
        refused_bytes: input that was discarded: text to read-only ports, lines and programs too long, or too many that
            wait.
        refused_programs: texts that were ignored because of the state of the controller.
        late: cycles whose packets were sent more than one cycle after they were due.
        skipped: cycles whose packets were not sent because they were far too late.
        lost_messages: texts and popups of programs, beyond what one cycle sends; and messages of a controller that was
            stepped, beyond what it keeps until they are taken.
        ignored_packages: packages of RTDE clients that do not fit, such as data of an unknown recipe.
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
    """Why the safety mode has changed.

    Attributes:
        reason: for the message; "" if none was given.
        by_program: whether a program has called `protective_stop()`.
    """

    reason: str = ""
    by_program: bool = False


class StateOutbox:
    """The robot messages that wait to be sent to the clients of the primary interface.

    Args:
        counters: counts the lost messages.
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
        """Add a message unless there are too many already, in which case it is lost. It is made only if it is added."""
        if self._size > MOST_MESSAGES:
            self._counters.lost_messages += 1
        else:
            self.put(make())

    def take(self) -> list[bytes]:
        """All messages, once each."""
        messages, self._messages, self._size = self._messages, [], 0
        return messages


class ControllerState:
    """The state of a controller.

    Args:
        kinematics: of the arm.
        firmware: the first one.
        source: what the arm follows when the controller has come up.
        serial: serial number of the arm.
        seed: of the noise on the sensors.
        noise: whether there is any.
        like: what was identified of an arm; None for what is known of the model.

    Attributes:
        kinematics, serial: as given.
        firmware: the present one.
        rate: cycles a second.
        period: s from one cycle to the next.
        cycle: number of the cycle since the controller was made, reboots included.
        uptime: cycles since the controller came up.
        cycles_down: until a reboot is over; 0 while it is up.
        surroundings: what the tool touches; they outlive a reboot.
        arm: joints, tool and sensors.
        modes: of robot, safety and program.
        signals: inputs and outputs.
        modbus: signals by name, with no bus behind them.
        registers: general-purpose registers, which a reboot clears (a guess).
        watchdogs: of the program that runs, over RTDE inputs.
        rtde_inputs: name -> the last value that a client has sent.
        claims: which client holds which RTDE input.
        fieldbus: that is enabled in the installation, a key of `FIELDBUSES`, or None.
        source: where the arm's set-points come from.
        is_paused: whether the source is paused: its program was, by hand or by a stop.
        resumes: whether the program goes on by itself when the stop is over.
        by_hand: moves the arm from the pendant while no program plays; None if nothing does.
        speed_fraction: of the speed slider, 0 to 1.
        slider: the fraction that the movement of the speed slider has come to; it follows `speed_fraction`.
        scaling: the fraction of their speed with which the commands of programs are executed; it follows `slider`, and
            is 0 at the start of a program.
        scaling_parameters: as given.
        remote_control: whether an e-Series is in remote control.
        has_local_control: whether an e-Series that is not in remote control refuses commands from outside the pendant.
        control_mode: what the program that runs controls; position without a program.
        teach_button: whether the button for freedrive is held.
        flags: of `set_flag`.
        stopped_since: `time` at which the present stop began; None without one.
        popup: text that the pendant shows, or None.
        loaded: path of the program that `play` runs, or None.
        log: lines that the dashboard has added.
        counters: of events on the interfaces.
        outbox: messages to be sent.
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
        like: ArmFile | None = None,
    ) -> None:
        self.kinematics = kinematics
        self.scaling_parameters = scaling_parameters
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
        self.arm = self._make_arm()
        self._next_firmware = firmware
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
        self._stop_cause = StopCause()
        self._announced = self.modes.safety_mode
        self.update_modes(0.0)

    def _make_arm(self) -> SimulatedArm:
        setpoint = self._first_source.advance(0.0)
        return SimulatedArm(self.kinematics, setpoint, self._noise_seed, self.surroundings, self._like)

    def go_down(self, firmware: Firmware | None, seconds: float) -> None:
        """Reboot: down for some seconds, at least a cycle; then with this firmware, or the present one.

        Without power the brakes of the joints hold the arm. The way that it slides until they do is left out.
        """
        self.cycles_down = max(1, math.ceil(seconds * self.rate))
        self._next_firmware = firmware or self.firmware
        self.outbox.take()
        self.arm.advance(self.period, Setpoint(self.arm.setpoint.q, [0.0] * 6, [0.0] * 6))

    def come_up(self) -> None:
        """End the reboot. The arm has not moved; tool and payload are in the installation, and stay.

        That popup and loaded program are gone, and signals, remote control and log stay, is a guess.
        """
        before = self.arm
        self._first_source.start(before.setpoint.q)
        self.arm = self._make_arm()
        self.arm.take_tool_of(before)
        self._begin()

    # -- time ----------------------------------------------------------------------------------------

    @property
    def model(self) -> Model:
        """Geometry as published, limits and masses of the arm."""
        return self.kinematics.model

    @property
    def time(self) -> float:
        """Seconds since the controller came up: whole cycles."""
        return self.uptime / self.rate

    @property
    def is_up(self) -> bool:
        """Whether it is up; False while it reboots."""
        return self.cycles_down == 0

    @property
    def is_local(self) -> bool:
        """Whether it accepts commands from the pendant alone: an e-Series in local control."""
        return self.firmware.is_e_series and self.has_local_control and not self.remote_control

    def move_slider(self, seconds: float) -> None:
        """Let the speed slider take effect, as far as it does in some seconds."""
        self.slider = approached(self.slider, self.speed_fraction, self.scaling_parameters.slider_rate * seconds)

    @property
    def speed_scaling(self) -> float:
        """As all interfaces show it: `slider` while a program plays.

        The start of a program does not show in it: in the log of a UR3e it is 1 while the joints still speed up.
        """
        return self.modes.speed_scaling * self.slider

    @property
    def time_scale_source(self) -> TimeScaleSource:
        """What scales the motion. That the slider and the start of a program are a smooth transition is a guess."""
        if self.modes.program_state is not ProgramState.PLAYING:
            return TimeScaleSource.PROGRAM_NOT_RUNNING
        is_changing = self.slider != self.speed_fraction or self.scaling != self.slider
        return TimeScaleSource.SMOOTH_TRANSITION if is_changing else TimeScaleSource.NOT_SCALED

    # -- modes ---------------------------------------------------------------------------------------

    def update_modes(self, seconds: float) -> None:
        """Update the modes by the state of arm and program, after `seconds`."""
        is_standing = self.arm.is_standing or self.by_hand is not None
        self.modes.advance(seconds, is_standing, self.source.is_program, self.is_paused)

    def stop_protectively(self, reason: str, *, by_program: bool = False) -> None:
        """Make a protective stop; the reason, and whether a program has asked for it, are for its message."""
        self._stop_cause = StopCause(reason, by_program)
        self.modes.protective_stop()

    def take_safety_change(self) -> StopCause | None:
        """The cause of a change of the safety mode since the last call; None without a change."""
        cause, self._stop_cause = self._stop_cause, StopCause()
        modes = self.modes
        if modes.safety_mode is self._announced:
            return None
        self._announced = modes.safety_mode
        self.stopped_since = None if modes.stop is StopState.NONE else self.time
        return cause if modes.stop is StopState.PROTECTIVE else StopCause()


def firmware_for(model: Model, firmware: str | Firmware) -> Firmware:
    """The firmware, if it runs on the model.

    UR3, UR5 and UR10 run 1.x (not the UR3, which came with CB3) and 3.x, all others 5.0 and later. With which later
    release the younger arms came is not checked.

    Raises:
        BadVersion: no such firmware.
        BadValue: it does not run on the model.
    """
    parsed = existing_firmware(firmware)
    if model.generation == "e":
        suits, needs = parsed.is_e_series, "5.0 or later"
    elif model.name == "UR3":
        suits, needs = not parsed.is_e_series and not parsed.is_cb2, "3.x"
    else:
        suits, needs = not parsed.is_e_series, "1.x or 3.x"
    if not suits:
        raise BadValue(f"a {model.name} does not run firmware {parsed}; it needs {needs}")
    return parsed

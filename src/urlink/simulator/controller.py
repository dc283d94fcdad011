"""`Controller`: wires up state, programs, faults and interfaces, and serves or steps them."""

from __future__ import annotations

import contextlib
import dataclasses
import ipaddress
import os
from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from types import TracebackType
from typing import TYPE_CHECKING, Literal

from linkcore import clock
from linkcore.errors import BadValue, LocalError
from linkcore.names import StrictAttributes
from urlink.arm import models
from urlink.arm.arm_file import ArmFile
from urlink.arm.kinematics import Arm as Kinematics
from urlink.arm.kinematics import DenavitHartenberg
from urlink.arm.models import Model
from urlink.protocol.firmware import NEWEST, RELEASES, Firmware
from urlink.protocol.ports import PORTS, interface_of
from urlink.session.address import RobotAddress

from .control_loop import ControlLoop, SteppedClock, passing
from .faults import Faults, FaultSchedule, LinkFaults, ScheduledFault
from .faults.schedule import checked
from .interfaces.dashboard import DashboardInterface
from .interfaces.gripper import GripperInterface
from .interfaces.interface import Interface, InterfaceClient, ScriptReceiver
from .interfaces.interpreter import InterpreterInterface
from .interfaces.primary import PrimaryInterface, SecondaryInterface, StatePackages
from .interfaces.realtime import RealtimeInterface
from .interfaces.robot_api import RobotApiInterface
from .interfaces.rtde import RtdeInterface
from .interfaces.tool_serial import ToolSerialInterface
from .programs.loader import LineAssembler, ProgramLoader
from .programs.pendant import Pendant
from .programs.program_world import Target
from .programs.runner import ProgramRunner
from .registers import FIELDBUSES, RegisterBanks
from .robot.arm import SimulatedArm
from .robot.characteristics import ScalingParameters
from .robot.gripper import ModbusGripper, SimulatedGripper
from .robot.modes import Modes
from .robot.scene import open_scene
from .robot.setpoint_sources import SetpointSource, Still
from .robot.signals import ModbusSignals, Signals
from .robot.surroundings import Surroundings
from .state import ControllerState, Counters, firmware_for

if TYPE_CHECKING:
    from typing_extensions import Self

    from .server import Server

_NEWEST_CB3 = [row.since for row in RELEASES if row.since.major == 3][-1]

# Addresses to listen on that cannot be connected to.
_ALL_ADDRESSES = ("", "0.0.0.0", "::")
# Addresses from which the system connects to loopback addresses.
_FIRST_LOOPBACK = ("127.0.0.1", "::1")
# The number of each port of a real controller -> its name.
_NAMES = {number: name for name, number in PORTS.items()}
#: Most lines from clients, and robot messages of a stepped controller, that are kept.
RECEIVED, KEPT_MESSAGES = 1000, 10_000


class Controller(StrictAttributes):
    """A robot controller in software: it serves the primary, secondary and real-time interfaces, RTDE and the dashboard
    (or the Robot API of PolyScope X), and runs the URScript that is sent to it.

    As a context manager it serves its ports from one thread of its own::

        with Controller("UR5e", "5.11") as controller:
            print(controller.host, controller.ports["realtime"])

    Until it is started it has no thread and no socket, and `step` advances it cycle by cycle: everything is then the
    same for the same seed, to the last byte.

    Args:
        model: name of the arm, such as `"UR10"`; None for a UR5e, or for a UR5 if the firmware is older than 5.0.
        firmware: None for the newest that suits the model.
        host: address to listen on; `""` for every IPv4 address of this computer, `"::"` for those of both families.
        ports: `"free"` for any that are free, `"standard"` for those that a real controller of this firmware has (80,
            for the Robot API of PolyScope X, may need rights), or a mapping from names in
            `PORTS` to numbers, 0 for a free one; ports that it leaves out are not served.
        seed: of the noise on the sensors and of random garbage.
        noise: whether the sensors are noisy; without noise the actual joints of an arm that stands are its targets.
        serial: serial number of the arm.
        motion: the source of set-points until a program commands the arm: `Demonstration` moves it slowly, `Still` has
            a posture to stand in; None to stand in `HOME`.
        output_limit: bytes that may wait for one client, besides what the network has buffered. Beyond it, packets of
            the primary, secondary and real-time interface are left out, and a client of the dashboard is disconnected.
        files: path -> URScript of the programs that are saved at the pendant.
        reachable: numeric addresses, other than this computer, to which programs may open sockets. Those of connected
            clients are always allowed.
        calibration: DH parameters of the arm; it then moves as they say and sends them. None for those published.
        gripper: whether a Robotiq gripper is mounted and its URCap serves it.
        stepped: time passes only by `step` and within `passing`, even while the ports are served. For tests that need
            the robot at a certain moment.
        scaling: how the speed scaling of programs behaves, where that is not known or to be tried.
        like: what was identified of an arm, which this one is then: model, calibration, TCP and payload, motors, lag,
            noise, and the ramp of programs, as far as the recording shows them.
        scene: a file of bodies around the arm, which the adapter for its ending opens, such as urlink-mujoco `.xml`.

    Attributes:
        host: address that it listens on.
        faults: faults to cause on demand.
        pendant: its saved programs, what it shows, and its buttons.
        received: (name of the interface, line of text) of the latest lines that clients sent.
        rtde: the RTDE interface: its connections, for a stepped controller; and which client holds an input.
        dashboard: answers the lines of dashboard clients.
        robot_api: answers the HTTP requests of PolyScope X; holds the operational mode.
        tool_serial: the serial line in the tool connector: its `device`, the gripper by Modbus RTU unless it is set.

    Raises:
        UnknownModel: no such arm.
        BadVersion: no such firmware.
        BadValue: the firmware does not run on the model, the calibration is not of such an arm, `ports` is none of the
            above, an address in `reachable` is not numeric, or there is no file `scene`.
        LocalError: no adapter for the ending of `scene` is installed, or it cannot open it.
    """

    def __init__(
        self,
        model: str | None = None,
        firmware: str | Firmware | None = None,
        *,
        host: str = "127.0.0.1",
        ports: Literal["free", "standard"] | Mapping[str, int] = "free",
        seed: int = 0,
        noise: bool = True,
        serial: str = "20230000001",
        motion: SetpointSource | None = None,
        output_limit: int = 1 << 20,
        files: Mapping[str, str] | None = None,
        reachable: Iterable[str] = (),
        calibration: DenavitHartenberg | None = None,
        gripper: bool = True,
        stepped: bool = False,
        scaling: ScalingParameters = ScalingParameters(),  # noqa: B008 -- it is frozen
        like: ArmFile | None = None,
        scene: str | os.PathLike[str] | None = None,
    ) -> None:
        if like is not None:
            if model is not None and models.model(model).name != like.model:
                raise BadValue(f"a {models.model(model).name} is not like a {like.model}, of which the file is")
            model, calibration = like.model, calibration or like.calibration
            if (rate := like.known("start_rate")) is not None:
                scaling = dataclasses.replace(scaling, start_rate=rate)
        if model is None:
            model = "UR5" if firmware is not None and not Firmware.parse(firmware).is_e_series else "UR5e"
        arm = models.model(model)
        kinematics = Kinematics(arm) if calibration is None else Kinematics.calibrated(arm, calibration)
        newest = NEWEST if arm.generation == "e" else _NEWEST_CB3
        chosen = firmware_for(arm, newest if firmware is None else firmware)
        self.host = host
        self.received: deque[tuple[str, str]] = deque(maxlen=RECEIVED)
        self._output_limit = output_limit
        self._numbers = _port_numbers(ports, chosen)
        self._reachable = frozenset(map(_numeric, reachable))
        self._server: Server | None = None
        self._stepped = SteppedClock(chosen.rate) if stepped else None
        self._clock: Callable[[], float] = self._stepped or clock.now
        # Of the cycles that were stepped, until they are taken.
        self._messages: deque[bytes] = deque()
        source = motion or Still()
        self._state = state = ControllerState(
            kinematics, chosen, source, serial=serial, seed=seed, noise=noise, scaling_parameters=scaling, like=like
        )
        self._runner = ProgramRunner(state, self._route)
        self._loader = ProgramLoader(state, self._runner)
        self.pendant = Pendant(state, self._runner, files or {})
        self._link = LinkFaults(lambda: state.cycle)
        self.rtde = RtdeInterface(state, lambda text: self.received.append(("rtde", text)))
        self.faults = Faults(state, self._runner, self._link, self.rtde, seed=seed, call=self.call)
        self._schedule = FaultSchedule(self.faults)
        self._control = ControlLoop(state, self._runner, self._schedule)
        self._states = StatePackages(state)
        self.dashboard = DashboardInterface(state, self.pendant)
        self.robot_api = RobotApiInterface(state, self.dashboard, self.pendant)
        self._gripper = SimulatedGripper(lambda: state.time) if gripper else None
        device = None if self._gripper is None else ModbusGripper(self._gripper)
        self.tool_serial = ToolSerialInterface(state, device)
        self._realtime = RealtimeInterface(state, self._script_receiver)
        self._interfaces: dict[str, Interface] = {
            "primary": PrimaryInterface(state, self._states, self._script_receiver),
            "secondary": SecondaryInterface(state, self._states, self._script_receiver),
            "realtime": self._realtime,
            "rtde": self.rtde,
            "dashboard": self.dashboard,
            "robot_api": self.robot_api,
            "interpreter": InterpreterInterface(state, self._runner),
            "gripper": GripperInterface(state, self._gripper),
            "tool_serial": self.tool_serial,
        }
        if scene is not None:
            self.world.scene = open_scene(scene, self)

    def _script_receiver(self, interface: str, client: InterfaceClient) -> ScriptReceiver:
        return ScriptReceiver(
            client, self.counters, lambda line: self.received.append((interface, line)), self._loader.open().put
        )

    def _route(self, address: str, port: int) -> Target | None:
        """Where a connection of a program to this numeric address and port goes; see `program_world.Route`."""
        if ipaddress.ip_address(address).is_loopback:
            own = _NAMES.get(port)
            if own is None:
                return Target(address, port, _source(self.host, address))
            number = self._all_ports.get(own)
            return None if number is None else Target(self._own_host, number)
        peers = () if self._server is None else self._server.peers
        return Target(address, port) if address in self._reachable or address in peers else None

    @property
    def _own_host(self) -> str:
        """The address of this controller for this computer."""
        return "127.0.0.1" if self.host in _ALL_ADDRESSES else self.host

    # -- properties ----------------------------------------------------------------------------------

    @property
    def model(self) -> Model:
        """The arm's model."""
        return self._state.model

    @property
    def serial(self) -> str:
        """Serial number of the arm."""
        return self._state.serial

    @property
    def firmware(self) -> Firmware:
        """The controller's firmware at present."""
        return self._state.firmware

    @property
    def cycle(self) -> int:
        """Number of the cycle since the controller was made, reboots included."""
        return self._state.cycle

    @property
    def time(self) -> float:
        """Seconds since the controller started or came back from a reboot: whole cycles."""
        return self._state.time

    @property
    def is_up(self) -> bool:
        """Whether it is up; False while it reboots, until its ports are open again."""
        server = self._server
        return self._state.is_up and (server is None or server.is_open)

    @property
    def arm(self) -> SimulatedArm:
        """The joints at present: set-point, sensors, TCP and payload. A reboot makes a new object."""
        return self._state.arm

    @property
    def world(self) -> Surroundings:
        """The surroundings of the tool: planes and springs can be placed, a load hung at the flange, and a
        scene of bodies set."""
        return self._state.surroundings

    @property
    def modes(self) -> Modes:
        """Modes of robot, safety and program. A reboot makes a new object."""
        return self._state.modes

    @property
    def signals(self) -> Signals:
        """Inputs and outputs."""
        return self._state.signals

    @property
    def modbus(self) -> ModbusSignals:
        """Modbus signals by name: programs read 42 after `modbus["pressure"] = 42`."""
        return self._state.modbus

    @property
    def registers(self) -> RegisterBanks:
        """General-purpose registers: what programs read and write. A reboot makes a new object."""
        return self._state.registers

    @property
    def flags(self) -> list[bool]:
        """Of `set_flag`."""
        return self._state.flags

    @property
    def gripper(self) -> SimulatedGripper:
        """The mounted gripper: the object between its fingers, and its faults.

        Raises:
            LocalError: the controller was made without one.
        """
        if self._gripper is None:
            raise LocalError("no gripper is mounted: the controller was made with gripper=False")
        return self._gripper

    @property
    def fieldbus(self) -> str | None:
        """The fieldbus that is enabled in the installation and reserves RTDE inputs: "EtherNet/IP", "PROFINET" or None.
        Can be set; clients keep the inputs that they hold.

        Raises:
            BadValue: on setting it to something else.
        """
        return self._state.fieldbus

    @fieldbus.setter
    def fieldbus(self, name: str | None) -> None:
        if name is not None and name not in FIELDBUSES:
            raise BadValue(f"a fieldbus is {' or '.join(FIELDBUSES)}, not {name!r}")
        self._state.fieldbus = name

    @property
    def counters(self) -> Counters:
        """Counters of events on the interfaces."""
        return self._state.counters

    @property
    def stopped_since(self) -> float | None:
        """`time` at which the present stop began; None if there is no stop."""
        return self._state.stopped_since

    @property
    def remote_control(self) -> bool:
        """Whether an e-Series is in remote control, and so accepts commands from outside the pendant. Can be set."""
        return self._state.remote_control

    @remote_control.setter
    def remote_control(self, is_remote: bool) -> None:
        self._state.remote_control = is_remote

    @property
    def has_local_control(self) -> bool:
        """Whether an e-Series that is not in remote control refuses commands from outside the pendant. Can be set.

        If False, the controller accepts them although `remote_control` is False, as URSim does. Assumption: the feature
        "remote control" is off in the settings of such a controller.
        """
        return self._state.has_local_control

    @has_local_control.setter
    def has_local_control(self, is_distinguished: bool) -> None:
        self._state.has_local_control = is_distinguished

    @property
    def teach_button(self) -> bool:
        """Whether the button for freedrive is held: only `robot_status_bits` shows it. Can be set."""
        return self._state.teach_button

    @teach_button.setter
    def teach_button(self, is_held: bool) -> None:
        self._state.teach_button = is_held

    @property
    def speed_fraction(self) -> float:
        """Position of the speed slider, 0 to 1. Can be set."""
        return self._state.speed_fraction

    @speed_fraction.setter
    def speed_fraction(self, fraction: float) -> None:
        self._state.speed_fraction = fraction

    @property
    def program_name(self) -> str | None:
        """Name of the program that runs or is paused, or None."""
        program = self._runner.program
        return None if program is None else program.name

    @property
    def is_running_program(self) -> bool:
        """Whether a program that was sent runs or waits for its turn; secondary programs count."""
        return self._runner.is_running

    # -- commands ------------------------------------------------------------------------------------

    def step(self, cycles: int = 1) -> None:
        """Advance by controller cycles of 8 ms (CB) or 2 ms (e-Series).

        If the controller serves its ports (`stepped`): from any thread; when it returns, the packets of these cycles
        are on their way to the clients.

        Raises:
            LocalError: the controller was started without `stepped`, so its own thread steps it.
        """
        if self._server is not None:
            if self._stepped is None:
                raise LocalError(
                    "a controller that serves its ports cannot be stepped, unless it was made stepped=True"
                )
            self.call(lambda: None)  # clients that have connected by now are accepted before time passes
            while cycles > 0:
                # Packets that are late by more than a second would be left out.
                some = min(cycles, self.firmware.rate // 5)
                self._stepped.advance(some)
                self.call(lambda: None)
                cycles -= some
            return
        for _ in range(cycles):
            self._control.advance()
            self._messages += self._state.outbox.take()
        while len(self._messages) > KEPT_MESSAGES:
            self._messages.popleft()
            self.counters.lost_messages += 1

    def passing(self, speed: float = 1.0) -> contextlib.AbstractContextManager[None]:
        """``with controller.passing():`` lets time pass while the block is executed; for `stepped`.

        Args:
            speed: factor of real time; less if the machine is too slow. What a client does in its own time, such as
                streaming set-points, does not get faster.

        Raises:
            LocalError: the controller serves its ports and was not made with ``stepped=True``.
            BadValue: `speed` is not a positive number.
        """
        if self._server is not None and self._stepped is None:
            raise LocalError("the time of this controller passes by itself; it was not made stepped=True")
        return passing(self.step, self.firmware.rate, speed)

    def take(self, text: str) -> None:
        """Load text as if a client had sent it: the lines of one or more programs, or of commands.

        From any thread. Programs begin in the next cycle, however long they are. A program without `end` is discarded,
        as that of a client that disconnects.
        """
        assembler = LineAssembler()
        lines = [line.removesuffix("\r") for line in text.split("\n")]
        programs = [program for program in map(assembler.feed, lines) if program is not None]

        def load() -> None:
            for program in programs:
                self._loader.load(program)

        self.call(load)

    def follow(self, source: SetpointSource) -> None:
        """Brake the arm, then let it follow another source of set-points; a program that runs ends. From any thread."""
        self.call(lambda: self._runner.follow(source))

    def push(self, wrench: Sequence[float], joint_torques: Sequence[float] = (0.0,) * 6) -> None:
        """Push the arm from now on: in freedrive or force mode it yields, otherwise it shows the force.
        Six zeros end it. From any thread.

        Args:
            wrench: (6,) at the TCP, N in the directions of the base frame, and Nm about the TCP.
            joint_torques: (6,) Nm at the joints, in addition.

        Raises:
            BadValue: not six finite numbers each.
        """
        self.world.push(wrench)
        self.world.push_joints(joint_torques)

    def schedule(self, *faults: str | ScheduledFault) -> None:
        """Schedule faults, in seconds since the controller was made: `schedule("protective_stop@5")`.

        Raises:
            BadValue: a text that `parse_fault` cannot read, no such fault, or a reboot into firmware that does not run
                on the model.
        """
        wanted = checked(faults, self.model)
        self.call(lambda: self._schedule.add(wanted))

    # -- packets and messages ------------------------------------------------------------------------

    def realtime_packet(self) -> bytes:
        """The real-time packet of this cycle."""
        return self._realtime.packet()

    def state_package(self, first: bool = False) -> bytes:
        """The robot state of this cycle; with `first`, that of a new connection, with kinematics and configuration."""
        return self._states.package(first)

    def take_messages(self) -> list[bytes]:
        """The robot messages that wait for the clients of the primary interface, once each.

        If the controller is stepped: those of all cycles since the last call, oldest first. Of more than 10,000 the
        oldest are dropped, and counted in `counters.lost_messages`.
        """
        messages = [*self._messages, *self._state.outbox.take()]
        self._messages.clear()
        return messages

    def greeting(self, port: str) -> list[bytes]:
        """The packets at the beginning of a connection to this port: none on the real-time ports."""
        return self._interfaces[interface_of(port)].greeting()

    # -- serving -------------------------------------------------------------------------------------

    @property
    def ports(self) -> dict[str, int]:
        """Name of each port that is served -> its number; empty until started.

        Ports whose interface the present firmware does not have are left out. A reboot into another firmware may add or
        remove some.
        """
        return {name: number for name, number in self._all_ports.items() if self._serves(name)}

    @property
    def _all_ports(self) -> dict[str, int]:
        """`ports`, and those that refuse connections until the firmware has their interface."""
        return {} if self._server is None else self._server.numbers

    def _serves(self, port: str) -> bool:
        return self._interfaces[interface_of(port)].is_offered()

    @property
    def address(self) -> str:
        """The address for `urlink.connect`. It has all ports, so that it stays valid when the firmware changes.

        Raises:
            LocalError: it has not been started.
        """
        if self._server is None:
            raise LocalError("a controller that has not been started has no address")
        return str(RobotAddress(self._own_host, self._all_ports))

    @property
    def is_serving(self) -> bool:
        """Whether it was started and not closed."""
        return self._server is not None

    def call(self, change: Callable[[], object]) -> None:
        """Call a function between two cycles, in the thread that owns the controller, and wait until it returns.

        For changes that must not happen in the middle of a cycle; from any thread.
        """
        server = self._server
        if server is None:
            change()
        else:
            server.call(change)

    def start(self) -> Self:
        """Listen on the ports and serve them from a thread. No effect if it does so already.

        Raises:
            BadAddress: the ports cannot be listened on.
        """
        if self._server is None:
            # The module with sockets is imported only when the controller begins to serve.
            from .server import Server

            server = Server(
                self._control,
                self._state,
                self._interfaces,
                self._loader,
                self._link,
                host=self.host,
                numbers=self._numbers,
                output_limit=self._output_limit,
                clock=self._clock,
            )
            self._server = server
            server.start()
        return self

    def close(self) -> None:
        """End all connections and the thread, within about a second. No effect if it is not started."""
        server, self._server = self._server, None
        if server is not None:
            server.close()
            self._runner.close()
            self.take_messages()

    def __enter__(self) -> Self:
        return self.start()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"<Controller {self.model.name}, firmware {self.firmware}>"


def _source(host: str, target: str) -> str | None:
    """The loopback address of a controller that listens on `host`, if it is not the one that the system chooses.

    A client accepts a program only from the address of its robot, and each of several controllers on this computer may
    have its own loopback address.
    """
    try:
        own = ipaddress.ip_address(host)
    except ValueError:
        return None
    is_other = own.is_loopback and own.version == ipaddress.ip_address(target).version and host not in _FIRST_LOOPBACK
    return host if is_other else None


def _numeric(address: str) -> str:
    try:
        return str(ipaddress.ip_address(address))
    except ValueError:
        raise BadValue(f"a reachable address is numeric, such as 192.168.1.2, not {address!r}") from None


def _port_numbers(ports: str | Mapping[str, int], firmware: Firmware) -> dict[str, int]:
    if ports == "standard":
        # Port 80 needs rights that few processes have, so it is opened only if it is used.
        needless = "dashboard" if firmware.is_polyscope_x else "robot_api"
        return {name: number for name, number in PORTS.items() if name != needless}
    if ports == "free":
        return dict.fromkeys(PORTS, 0)
    if isinstance(ports, str) or not ports or not ports.keys() <= PORTS.keys():
        raise BadValue(f"ports are 'free', 'standard' or a mapping from {', '.join(PORTS)}; not {ports!r}")
    return dict(ports)

"""Class `Controller`: connects state, programs, faults and interfaces. It serves them over TCP, or steps them."""

from __future__ import annotations

import contextlib
import dataclasses
import ipaddress
import os
from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from types import TracebackType
from typing import TYPE_CHECKING, Literal, TypeVar, get_args

from linkcore import clock
from linkcore.arguments import check_choice
from linkcore.errors import BadValue, LocalError
from linkcore.names import StrictAttributes
from urlink.arm import models
from urlink.arm.arm_file import ArmFile
from urlink.arm.kinematics import Arm as Kinematics
from urlink.arm.kinematics import DenavitHartenberg
from urlink.arm.models import Model
from urlink.arm.parameters import is_assumed
from urlink.protocol.firmware import NEWEST, RELEASES, Firmware, SlowFirmware
from urlink.protocol.ports import PORTS, interface_of
from urlink.session.address import Mounted, RobotAddress

from .control_loop import ControlLoop, SteppedClock, passing
from .faults import Faults, FaultSchedule, LinkFaults, ScheduledFault
from .faults.schedule import checked
from .interfaces.compute_box import ComputeBoxInterface
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
from .robot.rg_gripper import SimulatedRGGripper
from .robot.scene import open_scene
from .robot.setpoint_sources import SetpointSource, Still
from .robot.signals import ModbusSignals, Signals
from .robot.suction import SimulatedVacuumGripper
from .robot.surroundings import Surroundings
from .state import ControllerState, Counters, firmware_for

if TYPE_CHECKING:
    from typing_extensions import Self

    from .server import Server

G = TypeVar("G")

_NEWEST_CB3 = [row.since for row in RELEASES if row.since.major == 3][-1]

# Addresses that a server can listen on, but that a client cannot connect to.
_ALL_ADDRESSES = ("", "0.0.0.0", "::")
# Source addresses that the operating system uses for connections to loopback addresses.
_FIRST_LOOPBACK = ("127.0.0.1", "::1")
# Port number of a real controller -> name of the port.
_NAMES = {number: name for name, number in PORTS.items() if name != "onrobot"}
#: Maximum numbers of stored items: lines from clients, and robot messages of a stepped controller.
RECEIVED, KEPT_MESSAGES = 1000, 10_000


class Controller(StrictAttributes):
    """Simulated robot controller, with the interfaces of a real controller.

    The controller serves the primary, secondary and real-time interfaces, RTDE, and the dashboard (or the Robot API of
    PolyScope X). It runs the URScript programs that clients send.

    As a context manager, the controller serves its ports from a dedicated thread::

        with Controller("UR5e", "5.11") as controller:
            print(controller.host, controller.ports["realtime"])

    Until `start` is called, the controller has no thread and no socket, and `step` advances it cycle by cycle. Two runs
    with the same seed and the same steps then give the same bytes.

    Args:
        model: Name of the arm, such as `"UR10"`. None selects a UR5e, or a UR5 if the firmware is older than 5.0.
        firmware: Firmware of the controller. None selects the newest firmware that suits the model.
        host: Address to listen on. `""` means every IPv4 address of this computer; `"::"` means every IPv4 and IPv6
            address.
        ports: Ports to serve. `"free"` selects free ports. `"standard"` selects the ports of a real controller with
            this firmware; port 80, for the Robot API of PolyScope X, might need special rights. A mapping assigns port
            numbers to names in `PORTS`; 0 selects a free port. Ports that the mapping does not contain are not served.
        seed: Seed of the sensor noise and of random garbage.
        noise: Whether the sensors have noise, offsets and drift, like those of real arms. Without them, the actual
            joint positions of an arm at rest equal its targets, and the force of an empty tool is 0.
        serial: Serial number of the arm.
        motion: Source of set-points until a program commands the arm. `Demonstration` moves the arm slowly; `Still`
            holds it in a given posture. None holds it in `HOME`.
        output_limit: Maximum number of bytes buffered for one client, in addition to the buffers of the network. Above
            this limit, packets of the primary, secondary and real-time interfaces are dropped, and a dashboard client
            is disconnected.
        files: Programs that are saved on the pendant: path -> URScript.
        reachable: Numeric addresses, other than this computer, to which programs may open sockets. The addresses of
            connected clients are always allowed.
        calibration: DH parameters of the arm. The arm moves according to these parameters, and the controller sends
            them to clients. None selects the published parameters.
        gripper: Mounted gripper. True is a Robotiq 2F-85, "vacuum" a vacuum gripper of Robotiq, and "rg2" or "rg6" a
            gripper of OnRobot with its Compute Box. False mounts none, and removes the URCap of Robotiq.
        stepped: Whether time passes only in `step` and within `passing`, even while the ports are served. Use this for
            tests that examine the robot at a certain moment.
        scaling: Parameters of the speed scaling of programs. Some of them are not known for real controllers; set them
            to test other values.
        zeroes_force: Whether the start of a program zeroes the force sensor, default False. An engineer of the vendor
            states that it does (not verified: the log of a UR3e contradicts it).
        like: Arm file with identified properties of a real arm, which the simulated arm takes over. They are model,
            calibration, TCP and payload, motors, lag, noise, and the ramp of programs. Properties that were not
            identified keep their defaults.
        scene: File with the bodies around the arm. The adapter for the suffix of this file opens it, such as
            urlink-mujoco for `.xml`.
        frequency: Cycles per second, for tests that need fewer than a real controller executes: 25, 50, 100, 125, 250
            or 500 Hz with firmware 5.0 or later, 25 or 125 Hz with older firmware. None selects the frequency of a real
            controller.

    Attributes:
        host: Address that the controller listens on.
        faults: Faults that can be caused on demand.
        pendant: Teach pendant: its saved programs, its display and its buttons.
        received: Latest lines that clients sent, as (name of the interface, line of text).
        rtde: RTDE interface. Use it to connect a client without a socket, and to list the current connections.
        dashboard: Dashboard interface, which replies to the lines of its clients.
        robot_api: Robot API, which answers the HTTP requests of PolyScope X and holds the operational mode.
        tool_serial: Serial line in the tool connector. Its attribute `device` is initially the gripper (Modbus RTU),
            and can be set.

    Raises:
        UnknownModel: If there is no such arm.
        BadVersion: If there is no such firmware.
        BadValue: If the firmware does not run on the model, `model` differs from the model of `like`, the calibration
            belongs to another kind of arm, or `ports` has none of the forms above. If an address in `reachable` is not
            numeric, the file `scene` does not exist, or a controller with this firmware cannot have the `frequency`.
        LocalError: If no adapter for the suffix of `scene` is installed, or the adapter cannot open the file.
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
        gripper: bool | Mounted = True,
        stepped: bool = False,
        scaling: ScalingParameters = ScalingParameters(),  # noqa: B008 -- it is frozen
        zeroes_force: bool = is_assumed("force_zeroed_at_start"),
        like: ArmFile | None = None,
        scene: str | os.PathLike[str] | None = None,
        frequency: int | None = None,
    ) -> None:
        if like is not None:
            if model is not None and models.model(model).name != like.model:
                found = models.model(model).name
                raise BadValue(f"model={found!r}; expected {like.model!r}, the model of the arm file, or None")
            model, calibration = like.model, calibration or like.calibration
            if (rate := like.known("start_rate")) is not None:
                scaling = dataclasses.replace(scaling, start_rate=rate)
        if model is None:
            model = "UR5" if firmware is not None and not Firmware.parse(firmware).is_e_series else "UR5e"
        arm = models.model(model)
        kinematics = Kinematics(arm) if calibration is None else Kinematics.calibrated(arm, calibration)
        newest = NEWEST if arm.generation == "e" else _NEWEST_CB3
        chosen = firmware_for(arm, newest if firmware is None else firmware)
        if frequency is not None:
            chosen = chosen.at(frequency)
        self.host = host
        self.received: deque[tuple[str, str]] = deque(maxlen=RECEIVED)
        self._output_limit = output_limit
        check_choice(gripper, "gripper", (True, False, *get_args(Mounted)))
        self._numbers = _port_numbers(ports, chosen, has_box=gripper in ("rg2", "rg6"))
        self._reachable = frozenset(map(_numeric, reachable))
        self._server: Server | None = None
        self._stepped = SteppedClock(chosen.rate) if stepped else None
        self._clock: Callable[[], float] = self._stepped or clock.now
        # Robot messages of stepped cycles that `take_messages` has not returned yet.
        self._messages: deque[bytes] = deque()
        source = motion or Still()
        self._state = state = ControllerState(
            kinematics,
            chosen,
            source,
            serial=serial,
            seed=seed,
            noise=noise,
            scaling_parameters=scaling,
            zeroes_force=zeroes_force,
            like=like,
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
        self._gripper = SimulatedGripper(lambda: state.time) if gripper is True else None
        self._kind = gripper
        self._suction = SimulatedVacuumGripper(lambda: state.time) if gripper == "vacuum" else None
        self._rg = SimulatedRGGripper(gripper, lambda: state.time) if gripper in ("rg2", "rg6") else None
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
            "gripper": GripperInterface(state, self._gripper or self._suction),
            "tool_serial": self.tool_serial,
            "onrobot": ComputeBoxInterface(self._rg, state.counters),
        }
        if scene is not None:
            self.world.scene = open_scene(scene, self)

    def _script_receiver(self, interface: str, client: InterfaceClient) -> ScriptReceiver:
        return ScriptReceiver(
            client, self.counters, lambda line: self.received.append((interface, line)), self._loader.open().put
        )

    def _route(self, address: str, port: int) -> Target | None:
        """Return the target of a connection that a program opens to this address; see `program_world.Route`."""
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
        """Address at which this computer reaches the controller."""
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
        """Current firmware of the controller."""
        return self._state.firmware

    @property
    def cycle(self) -> int:
        """Number of cycles since the controller was made, including reboots."""
        return self._state.cycle

    @property
    def time(self) -> float:
        """Time since the controller started or last rebooted, in s: a whole number of cycles."""
        return self._state.time

    @property
    def is_up(self) -> bool:
        """Whether the controller is up; False from the start of a reboot until the ports are open again."""
        server = self._server
        return self._state.is_up and (server is None or server.is_open)

    @property
    def arm(self) -> SimulatedArm:
        """Current state of the joints: set-point, sensors, TCP and payload.

        A reboot creates a new object.
        """
        return self._state.arm

    @property
    def world(self) -> Surroundings:
        """Objects and forces that act on the arm.

        You can add planes and springs, attach a load to the flange, and set a scene of bodies.
        """
        return self._state.surroundings

    @property
    def modes(self) -> Modes:
        """Robot mode, safety mode and program state. A reboot creates a new object."""
        return self._state.modes

    @property
    def signals(self) -> Signals:
        """Inputs and outputs."""
        return self._state.signals

    @property
    def modbus(self) -> ModbusSignals:
        """Modbus signals by name. After `modbus["pressure"] = 42`, programs read 42 from the signal "pressure"."""
        return self._state.modbus

    @property
    def registers(self) -> RegisterBanks:
        """General-purpose registers, which programs read and write. A reboot creates a new object."""
        return self._state.registers

    @property
    def flags(self) -> list[bool]:
        """Flags that programs set with `set_flag`."""
        return self._state.flags

    @property
    def gripper(self) -> SimulatedGripper:
        """Mounted gripper. Use it to set the object between the fingers, and to cause faults.

        Raises:
            LocalError: If the controller was made without a gripper, or with another kind.
        """
        return self._mounted(self._gripper, "2F-85")

    @property
    def vacuum_gripper(self) -> SimulatedVacuumGripper:
        """Mounted vacuum gripper. Use it to set the object at the suction cups, and to cause faults.

        Raises:
            LocalError: If the controller was made without ``gripper="vacuum"``.
        """
        return self._mounted(self._suction, "vacuum gripper")

    @property
    def rg_gripper(self) -> SimulatedRGGripper:
        """Mounted RG2 or RG6. Use it to set the object between the fingers, and to cause faults.

        Raises:
            LocalError: If the controller was made without ``gripper="rg2"`` or ``"rg6"``.
        """
        return self._mounted(self._rg, "RG2 or RG6")

    def _mounted(self, gripper: G | None, kind: str) -> G:
        if gripper is None:
            raise LocalError(f"no {kind} is mounted: the controller was made with gripper={self._kind!r}")
        return gripper

    @property
    def fieldbus(self) -> str | None:
        """Fieldbus that is enabled in the installation and reserves RTDE inputs.

        The value is "EtherNet/IP", "PROFINET" or None, and can be set. Clients keep the inputs that they have already
        claimed.

        Raises:
            BadValue: If the fieldbus is set to another value.
        """
        return self._state.fieldbus

    @fieldbus.setter
    def fieldbus(self, name: str | None) -> None:
        if name is not None and name not in FIELDBUSES:
            raise BadValue(f"fieldbus={name!r}; expected None or one of {', '.join(FIELDBUSES)}")
        self._state.fieldbus = name

    @property
    def counters(self) -> Counters:
        """Counters of events on the interfaces."""
        return self._state.counters

    @property
    def stopped_since(self) -> float | None:
        """`time` at which the current stop began; None if there is no stop."""
        return self._state.stopped_since

    @property
    def remote_control(self) -> bool:
        """Whether an e-Series controller is in remote control, and therefore accepts external commands. Can be set."""
        return self._state.remote_control

    @remote_control.setter
    def remote_control(self, is_remote: bool) -> None:
        self._state.remote_control = is_remote

    @property
    def has_local_control(self) -> bool:
        """Whether an e-Series controller in local control rejects external commands. Can be set.

        External commands are all commands that do not come from the pendant. If False, the controller accepts external
        commands even if `remote_control` is False, as URSim does. Assumption: the feature "remote control" is off in
        the settings of such a controller.
        """
        return self._state.has_local_control

    @has_local_control.setter
    def has_local_control(self, is_distinguished: bool) -> None:
        self._state.has_local_control = is_distinguished

    @property
    def teach_button(self) -> bool:
        """Whether the freedrive button is held. Only `robot_status_bits` shows it. Can be set."""
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
        """Name of the program that is running or paused, or None."""
        program = self._runner.program
        return None if program is None else program.name

    @property
    def is_running_program(self) -> bool:
        """Whether a program from a client is running or queued; secondary programs count."""
        return self._runner.is_running

    # -- commands ------------------------------------------------------------------------------------

    def step(self, cycles: int = 1) -> None:
        """Advance by controller cycles of 8 ms (CB) or 2 ms (e-Series), or by longer ones at a lower `frequency`.

        If the controller serves its ports (`stepped`), any thread may call this. When the call returns, the packets of
        these cycles have been passed to the network.

        Args:
            cycles: Number of cycles, default 1.

        Raises:
            LocalError: If the controller serves its ports and was not made with ``stepped=True``.
        """
        if self._server is not None:
            if self._stepped is None:
                raise LocalError("a controller that serves its ports cannot be stepped; make it with stepped=True")
            self.call(lambda: None)  # accept waiting connections before time passes
            while cycles > 0:
                # Advance by at most 0.2 s at once, because packets that are more than a second late are dropped.
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
        """Advance the robot's time while a ``with controller.passing():`` block runs; needs `stepped`.

        Args:
            speed: Speed of the robot's time relative to real time, so 2.0 is twice real time. The robot's time passes
                more slowly if this computer is too slow. A client that works in real time, such as a loop that sends
                set-points, does not become faster.

        Raises:
            LocalError: If the controller serves its ports and was not made with ``stepped=True``.
            BadValue: If `speed` is not a positive number.
        """
        if self._server is not None and self._stepped is None:
            raise LocalError("the time of this controller passes automatically; make it with stepped=True")
        return passing(self.step, self.firmware.rate, speed)

    def take(self, text: str) -> None:
        """Load a text as if a client had sent it: one or more programs, or lines with commands.

        Any thread may call this. Even long programs begin in the next cycle. A program without `end` is discarded, as
        if the client had disconnected before the end of the program.
        """
        assembler = LineAssembler()
        lines = [line.removesuffix("\r") for line in text.split("\n")]
        programs = [program for program in map(assembler.feed, lines) if program is not None]

        def load() -> None:
            for program in programs:
                self._loader.load(program)

        self.call(load)

    def follow(self, source: SetpointSource) -> None:
        """Brake the arm, then let it follow another source of set-points.

        A running program ends. Any thread may call this.
        """
        self.call(lambda: self._runner.follow(source))

    def push(self, wrench: Sequence[float], joint_torques: Sequence[float] = (0.0,) * 6) -> None:
        """Push the arm with a constant wrench until the next call; six zeros end the push.

        In freedrive or force mode, the arm yields to the push. Otherwise the arm only reports the force. Any thread may
        call this.

        Args:
            wrench: Wrench at the TCP, shape (6,): forces in N along the axes of the base frame, and torques in Nm about
                the TCP.
            joint_torques: Additional torques at the joints, shape (6,), in Nm.

        Raises:
            BadValue: If an argument is not six finite numbers.
        """
        self.world.push(wrench)
        self.world.push_joints(joint_torques)

    def schedule(self, *faults: str | ScheduledFault) -> None:
        """Schedule faults, for example `schedule("protective_stop@5")`.

        The times are in seconds since the controller was made.

        Raises:
            BadValue: If `parse_fault` cannot read a text, a fault does not exist, or a reboot names firmware that does
                not run on the model.
        """
        wanted = checked(faults, self.model)
        self.call(lambda: self._schedule.add(wanted))

    # -- packets and messages ------------------------------------------------------------------------

    def realtime_packet(self) -> bytes:
        """Return the real-time packet of this cycle."""
        return bytes(self._realtime.packet())

    def state_package(self, first: bool = False) -> bytes:
        """Return the robot state of this cycle.

        Args:
            first: Whether to return the state for a new connection, which includes kinematics and configuration.
        """
        return self._states.package(first)

    def take_messages(self) -> list[bytes]:
        """Return and remove the messages that are queued for clients of the primary interface.

        If the controller is stepped, these are the messages of all cycles since the last call, oldest first. At most
        10,000 messages are stored. Older messages are dropped and counted in `counters.lost_messages`.
        """
        messages = [*self._messages, *self._state.outbox.take()]
        self._messages.clear()
        return messages

    def greeting(self, port: str) -> list[bytes]:
        """Return the packets at the beginning of a connection to this port.

        The real-time ports send no such packets.
        """
        return self._interfaces[interface_of(port)].greeting()

    # -- serving -------------------------------------------------------------------------------------

    @property
    def ports(self) -> dict[str, int]:
        """Served ports: name -> number. The mapping is empty until the controller is started.

        A port is not included if the current firmware does not have its interface. A reboot into another firmware might
        add or remove ports.
        """
        return {name: number for name, number in self._all_ports.items() if self._serves(name)}

    @property
    def _all_ports(self) -> dict[str, int]:
        """All ports, including those that currently refuse connections because the firmware lacks their interface."""
        return {} if self._server is None else self._server.numbers

    def _serves(self, port: str) -> bool:
        return self._interfaces[interface_of(port)].is_offered()

    @property
    def address(self) -> str:
        """Address for `urlink.connect`.

        The address contains all ports, so it stays valid when the firmware changes.

        Raises:
            LocalError: If the controller has not been started.
        """
        if self._server is None:
            raise LocalError("the controller has no address, because it has not been started; call start() first")
        firmware = self.firmware
        frequency = firmware.rate if isinstance(firmware, SlowFirmware) else None
        return str(RobotAddress(self._own_host, self._all_ports, frequency))

    @property
    def is_serving(self) -> bool:
        """Whether the controller was started and not closed."""
        return self._server is not None

    def call(self, change: Callable[[], object]) -> None:
        """Call a function between two cycles, in the thread that owns the controller.

        Use this for changes that must not happen in the middle of a cycle. The call waits until the function returns.
        Any thread may make this call.
        """
        server = self._server
        if server is None:
            change()
        else:
            server.call(change)

    def start(self) -> Self:
        """Listen on the ports and serve them from a thread. No effect if already started.

        Raises:
            BadAddress: If the controller cannot listen on the ports.
        """
        if self._server is None:
            # Import the module that uses sockets only when the controller begins to serve.
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
        """End all connections and the thread, within about a second. No effect if not started."""
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
    """Return `host` if it is a loopback address that the system would not choose as source; else None.

    A client accepts the connection of a program only if it comes from the address of the client's robot. If several
    controllers run on this computer, each can have its own loopback address.
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
        raise BadValue(
            f"invalid reachable address {address!r}; expected a numeric address, such as 192.168.1.2"
        ) from None


def _port_numbers(ports: str | Mapping[str, int], firmware: Firmware, *, has_box: bool) -> dict[str, int]:
    # Ports 80 and 502 need rights that few processes have, so they are opened only if they are used.
    needless = set() if has_box else {"onrobot"}
    if ports == "standard":
        needless.add("dashboard" if firmware.is_polyscope_x else "robot_api")
        return {name: number for name, number in PORTS.items() if name not in needless}
    if ports == "free":
        return {name: 0 for name in PORTS if name not in needless}
    if isinstance(ports, str) or not ports or not ports.keys() <= PORTS.keys():
        raise BadValue(f"ports={ports!r}; expected 'free', 'standard' or a mapping from {', '.join(PORTS)}")
    return dict(ports)

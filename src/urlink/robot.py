"""`connect()`, and `Robot`, the object that it returns."""

from __future__ import annotations

import os
import warnings
import weakref
from collections.abc import Callable, Hashable, Sequence
from pathlib import PurePath
from typing import TYPE_CHECKING, Any, Literal, Protocol

from linkcore import clock
from linkcore.arguments import check_callable, check_choice
from linkcore.errors import BadValue, Closed, LocalError
from linkcore.names import StrictAttributes, plugin
from linkcore.net.undo import PendingUndos
from linkcore.process import HomeProcess
from linkcore.streaming.stream import Stream
from linkcore.text import html_table
from linkcore.threads import Closing, MadeOnce

from .protocol.firmware import Firmware
from .protocol.ports import service_of
from .protocol.primary.robot_state import RobotState
from .protocol.realtime.packets import RealtimeState
from .session.address import RecordingAddress, RobotAddress, SimulatorAddress, parse_address
from .session.connect_options import ConnectOptions, takes_connect_options
from .session.identity import Identity, KnownIdentity
from .session.robot_clock import RobotClock
from .session.session_limits import SessionLimits
from .session.source import Source, networked, recorded

if TYPE_CHECKING:
    from numpy.typing import ArrayLike
    from typing_extensions import Self

    from linkcore.recording.recorder import Recorder

    from .arm.kinematics import Arm
    from .arm.payload import MeasuredPayload
    from .arm.vectors import Numbers
    from .command.interpreter import Interpreter
    from .command.io import IO
    from .command.safety import Safety
    from .command.scripts import Scripts
    from .motion import Freedrive, Motions
    from .motion.control import Control
    from .motion.motions import LinkName
    from .motion.payload_measurement import PayloadMeasurement
    from .motion.points.points import Points
    from .motion.teaching import TaughtPoint, Teaching
    from .motion.wrench import WrenchStream
    from .protocol.dashboard.client import Dashboard
    from .protocol.gripper.client import Gripper
    from .protocol.tool_serial import ToolSerial
    from .rtde import OutputStream, Registers, Rtde
    from .simulator import Controller


class View(Protocol):
    """Web page that shows an arm, made by the package ``urlink-view``. A context manager."""

    @property
    def address(self) -> str:
        """Address for browsers."""

    def close(self) -> None:
        """Close the view. Idempotent."""

    def __enter__(self) -> Self: ...

    def __exit__(self, *exc: object) -> None: ...


@takes_connect_options
def connect(options: ConnectOptions) -> Robot:
    """Connect to a robot, to the simulator, or to a recording.

    The call reads the identity of the controller. The streams connect when they are first used. This process might have
    abandoned commands that the controller at this address could still execute. In this case, the call first waits until
    these commands are undone, for at most `timeout` seconds; see docs/motion-ends.md. A connection with `read_only`
    undoes nothing.

    Args:
        address: Address of the robot, for example ``"192.168.56.101"``, ``"ur://host"``,
            ``"sim://ur5e?firmware=5.11"`` or ``"replay:///path/run.urlog?rate=2"``. The address may also be the path
            of a recording, such as ``"run.urlog"`` or any `pathlib.Path`.
        timeout: Maximum time to make any connection, in seconds.
        read_only: Whether to use ports 30011 to 30013, which accept no commands.
        backoff: Waiting times between attempts of a stream to reconnect.
        silence: Longest time without a packet, in seconds. After this time, a stream counts as disconnected.
        require_enable: Whether `robot.safety.enable()` must be called before the arm can be moved: "never",
            "on_startup" (once) or "always" (at first and after every stop).
        stale_after: Longest time without a packet from the robot, in seconds. After this time, motions end with
            `NotRunning` and new motions are refused.
        start_timeout: Longest time until an uploaded program starts, in seconds. A program that starts later gets no
            start permission, and ends without moving the arm.
        start_register: Number of the integer output register, 0 to 47, for the start permission of a program. All
            clients that use this library may share one register; no other program may use it. If None, the flags are
            used instead.
        start_flags: Numbers of the flags, 0 to 31, that carry the start permission on firmware that lacks the register
            (before 3.9 on CB3, before 5.3 on e-Series). With more flags, it is less likely that the permission of
            another client starts an abandoned program. With neither register nor flags, each program starts when the
            controller reads it, even if that is very late. In this case, the controller can still execute a motion
            long after its handle has failed.
        reverse_host: Address of this computer as seen by the robot, for streamed set-points. If None, the address is
            derived from the route to the robot.
        reverse_port: Port on this computer for connections from the robot; 0 for a free port.
        reverse_peer: Source address of the robot's connections; None for the address of the robot. A simulator in a
            container might connect from another address.
        commands_via: Interface that sets outputs and the speed slider. "auto" uses RTDE if the controller has RTDE and
            no other client has claimed the inputs; otherwise it uses a script. "script" never claims an RTDE input.
        isolate: Whether to read the real-time interface in a dedicated process. The newest state is then available at
            any time, even if your program holds the lock of the Python interpreter (GIL) for a long time. Not supported
            on Windows.
        limits: Limits for all commands of this connection, a `SessionLimits`: speeds, a box for the tool, the speed
            slider, and the allowed kinds of motion. A command that would exceed a limit raises `LimitExceeded`. The
            limits are not a safety function.
        points: Path of the JSON file for `robot.points`. The first taught point creates the file. If None,
            `robot.points` raises `LocalError`.

    Raises:
        BadAddress: If the address is invalid.
        BadRecording: If the recording does not exist, or the file is not a recording.
        BadValue: If a time is not positive, a policy or port does not exist, the simulated arm does not run the
            firmware, or no simulated controller with this firmware has the frequency.
        UnknownModel: If there is no such arm to simulate.
        ConnectFailed, ConnectionLost, LinkTimeout, WrongPeer: If there is no controller at the address, or if another
            kind of server replies.
    """
    if isinstance(options.place, RecordingAddress):
        refusal = f"{options.name} is a recording, so it cannot be commanded"
        return Robot(options.name, recorded(options.place), refusal=refusal, points=options.points)
    controller = robot = None
    place = options.place
    if isinstance(place, SimulatorAddress):
        controller, place = simulated(place)
    try:
        robot = assemble(options, place, networked(place, options), controller)
        if owes(robot, place):
            undo_abandoned(robot, options.timeout)
    except BaseException:
        opened = controller if robot is None else robot
        if opened is not None:
            opened.close()
        raise
    return robot


def simulated(place: SimulatorAddress) -> tuple[Controller, RobotAddress]:
    """Start a simulated controller, and return it with its address.

    Raises:
        UnknownModel, BadValue: If the arm does not exist or does not run the firmware, if the file belongs to another
            arm, or if the scene file does not exist.
        LocalError: If no adapter for the scene is installed, or the adapter cannot open the scene.
    """
    from .arm.arm_file import read_arm_file
    from .simulator import Controller, Demonstration

    like = None if place.like is None else read_arm_file(place.like)
    motion = Demonstration() if place.motion == "demo" else None
    controller = Controller(
        model=place.model,
        firmware=place.firmware,
        motion=motion,
        like=like,
        scene=place.scene,
        gripper=place.gripper or True,
        frequency=place.frequency,
    )
    controller.start()
    served_at = parse_address(controller.address)
    assert isinstance(served_at, RobotAddress), "a controller that has been started is at ports of this computer"
    return controller, served_at


def assemble(
    options: ConnectOptions,
    place: RobotAddress,
    source: Source,
    controller: Controller | None,
    known: Identity | None = None,
) -> Robot:
    """Return the `Robot` for a robot on the network, with the objects that command this robot.

    Args:
        known: Identity of the controller; None to ask the controller.

    Raises:
        RemoteError: If there is no controller at the address, or if another kind of server replies.
    """
    address = options.name

    def control(robot: Robot) -> Control:
        # A program that only reads states must not import the command modules: they are the largest part of urlink.
        from .motion.control import Control

        peers = peers_of(place) if controller is None else ()
        return Control(options, place, peers, robot.primary, robot.realtime, robot._who, _rtde_of(robot), source.sent)

    if options.read_only:
        refusal = f"{address} was connected with read_only=True, so it cannot be commanded"
        return Robot(address, source, controller, refusal=refusal, known=known, points=options.points)
    return Robot(
        address, source, controller, known=known, control=control, limits=options.limits, points=options.points
    )


def peers_of(place: RobotAddress) -> tuple[Hashable, ...]:
    """Return keys that identify a controller, and keys that identify its services for clients without a `Robot`."""
    services = ("dashboard", "robot_api", "gripper")
    parts = (service_of(place.host, place.ports[name]) for name in services if name in place.ports)
    return (place.host.casefold(), frozenset(place.ports.items())), *parts


def owes(robot: Robot, place: RobotAddress) -> bool:
    """Whether this process abandoned commands that the controller might still execute, and the robot can undo them."""
    return robot._make_control is not None and PendingUndos.is_owed(*peers_of(place))


def undo_abandoned(robot: Robot, timeout: float) -> None:
    """Wait up to `timeout` seconds until abandoned commands are undone. The open robot retries after this time."""
    robot._commanded().settle(timeout)


class Robot(StrictAttributes, Closing):
    """Connection to one robot: streams, identity and commands. A context manager; made by `connect`.

    Leaving its ``with`` block closes the robot.

    Attributes:
        address: Address that was passed to `connect`.
    """

    def __init__(
        self,
        address: str,
        source: Source,
        controller: Controller | None = None,
        *,
        refusal: str = "",
        known: Identity | None = None,
        control: Callable[[Robot], Control] | None = None,
        limits: SessionLimits | None = None,
        points: str | os.PathLike[str] | None = None,
    ) -> None:
        self._limits = limits
        self.address = address
        self._controller = controller
        self._make_control = control
        self._control: MadeOnce[Control] = MadeOnce()
        self._refusal = refusal
        self._points_path = points
        self._points: MadeOnce[Points] = MadeOnce()
        self._source = source
        self._who = KnownIdentity(source.ask, known)
        # Changed in single steps, so that a signal handler always sees a consistent dict.
        self._streams: dict[str, Stream[Any]] = {}
        self._rtde: MadeOnce[Rtde] = MadeOnce()
        self._registers: MadeOnce[Registers] = MadeOnce()
        self._home = HomeProcess(address)
        self._is_closed = False

    # -- streams and identity ----------------------------------------------------------------------

    @property
    def realtime(self) -> Stream[RealtimeState]:
        """Stream of `RealtimeState`, 125 or 500 Hz (port 30003)."""
        return self._stream("realtime")

    @property
    def primary(self) -> Stream[RobotState]:
        """Stream of `RobotState` at 10 Hz (port 30001). Select its parts and messages by class with `of`."""
        return self._stream("primary")

    @property
    def secondary(self) -> Stream[RobotState]:
        """Stream of `RobotState` like `primary`, but with the version message as its only message (port 30002)."""
        return self._stream("secondary")

    @property
    def clock(self) -> RobotClock:
        """Relation of the controller's clock to this computer's clock, measured on the real-time stream."""
        return RobotClock(self.realtime, self._who)

    @property
    def rtde(self) -> Rtde:
        """Access to RTDE: read and write controller variables by name, up to 500 times a second (port 30004)."""
        rtde = self._rtde.made
        if rtde is None:
            from .rtde import Rtde

            who = self._who  # a reference to `self` would be a cycle, because `self` holds the new object
            made = Rtde(
                self.address, self._source, lambda: who.identity.firmware, refusal=self._refusal, limits=self._limits
            )
            rtde = self._rtde.keep(made)
            if self._is_closed:
                rtde.close(0.0)
        return rtde

    @property
    def registers(self) -> Registers:
        """General-purpose registers by number, shared with the program on the controller. See `Registers`."""
        return self._registers.made or self._registers.keep(self.rtde.registers())

    @property
    def firmware(self) -> Firmware:
        """Firmware of the controller.

        After a reconnect, the first access asks the controller again, because its firmware might have changed. This
        access can raise the same errors as `connect`.
        """
        return self._who.identity.firmware

    @property
    def model(self) -> str | None:
        """Name of the arm, such as "UR5e"; None if the controller does not report it. See `firmware`."""
        return self._who.identity.model

    @property
    def identity(self) -> Identity:
        """Identity of the controller: firmware, model and calibration. See `firmware`."""
        return self._who.identity

    @property
    def limits(self) -> SessionLimits | None:
        """Limits of this session that were passed to `connect` as ``limits=``; None if there are none."""
        return self._limits

    @property
    def kinematics(self) -> Arm:
        """Forward and inverse kinematics of this individual arm, in the base frame of the controller.

        Firmware 1.8 or later sends the calibrated DH parameters when a connection starts. With these parameters, the
        results agree with the controller (`Arm.is_calibrated`). If no parameters were received, or a recording does not
        contain them, the published parameters of the model are used. The TCP that is set on the controller is not
        included: pass it as ``tcp=``.

        After a reconnect, the first access asks the controller again, as for `firmware`.

        Raises:
            LocalError: If the controller does not report its arm, or the arm is unknown.
            WrongPeer: If the controller sends DH parameters that do not belong to its arm.
        """
        return self._who.identity.kinematics

    @property
    def controller(self) -> Controller:
        """Simulator behind a ``sim://`` address: its faults, its inputs and its arm.

        Raises:
            LocalError: If `connect` did not start a simulator for this robot.
        """
        if self._controller is None:
            raise LocalError(
                f"{self.address} is not a simulator started by this program; connect to 'sim://' to start one"
            )
        return self._controller

    def record(
        self, path: str | os.PathLike[str], interfaces: Sequence[str | OutputStream[Any]] = ("realtime", "primary")
    ) -> Recorder:
        """Record streams into a new file, from now until the recorder is closed.

        Args:
            path: Path of the new file. A file that ends in .mcap contains ROS 2 messages, for Foxglove and
                `ros2 bag`. Any other file is a recording, which `urlink.load` can export to all formats.
            interfaces: Streams to record: "realtime", "primary", "secondary", and at most one stream made by
                `Rtde.outputs`.

        Raises:
            BadRecording: If the file exists, or cannot be created.
            BadValue: If an interface does not exist, two RTDE streams are given, or the format cannot be written live.
            LocalError: If the file is .mcap and the package ``urlink-view`` is not installed.
            RemoteError: If a stream cannot be opened.
        """
        streams = [("rtde", each) if isinstance(each, Stream) else (each, self._stream(each)) for each in interfaces]
        if len({name for name, _ in streams}) < len(streams):
            given = ", ".join(name for name, _ in streams)
            raise BadValue(f"interfaces contains {given}; expected each of them only once")
        recorder = _recorder(path)
        try:
            for name, stream in streams:
                recorder.add(
                    stream,
                    {"name": name, "address": self.address, **self.identity.description(), **stream.description()},
                )
        except BaseException:
            # Delete the new file if the robot cannot be reached.
            recorder.close()
            recorder.path.unlink(missing_ok=True)
            raise
        return recorder

    # -- commands -----------------------------------------------------------------------------------

    @property
    def safety(self) -> Safety:
        """Interlock between motions and the arm, with its state and policy.

        The command properties of a robot, such as `safety` and `motion`, raise `LocalError` if the connection cannot
        send commands.
        """
        return self._commanded().safety

    @property
    def script(self) -> Scripts:
        """Commands that send URScript programs and lines. See `Scripts`."""
        return self._commanded().script

    @property
    def io(self) -> IO:
        """Digital and analogue inputs and outputs. See `IO`."""
        return self._commanded().io

    @property
    def motion(self) -> Motions:
        """Commands that move the arm. See `Motions`."""
        return self._commanded().motion

    @property
    def dashboard(self) -> Dashboard:
        """Dashboard commands: power, brakes, installed programs, and unlocking after a protective stop."""
        return self._commanded().dashboard

    def interpreter(
        self,
        *,
        start_timeout: float = 10.0,
        finish_timeout: float = 60.0,
        on_text: Callable[[str], object] | None = None,
    ) -> Interpreter:
        """Start interpreter mode: the controller executes URScript statements one by one.

        The call uploads a program, which preempts the current program. The call returns when the new program accepts
        statements. Firmware 5.10 or later is required.

        Args:
            start_timeout: Maximum time until the program accepts statements, in seconds.
            finish_timeout: Maximum time for pending statements to finish when a ``with`` block is left, in seconds.
            on_text: Function that is called with each line of `textmsg`, in the robot's callback thread.

        Raises:
            BadValue: If an argument is not a valid time.
            LocalError: If the firmware has no interpreter mode.
            SafetyStop, NotRunning: If the arm must not be moved now. Nothing is sent.
            LinkTimeout: If interpreter mode does not start in time. No program is left on the controller.
            LinkError: If interpreter mode cannot be started, or if it ends before it accepts statements.
        """
        return self._commanded().interpreters.begin(start_timeout, finish_timeout, on_text)

    @property
    def gripper(self) -> Gripper:
        """Robotiq gripper, over its URCap on the controller (port 63352). Gripper commands are not interlocked.

        Call it for another kind: `robot.gripper("vacuum")`, or `robot.gripper("rg2", host="192.168.1.1")`.
        """
        return self._commanded().gripper

    @property
    def tool_serial(self) -> ToolSerial:
        """RS485 line in the tool connector of an e-Series, over a URCap (port 54321). Its commands are not interlocked.

        Raises:
            LocalError: If the controller has no such line.
        """
        return self._commanded().tool_serial

    def set_payload(
        self,
        mass: float | MeasuredPayload,
        cog: Sequence[float] | None = None,
        inertia: Sequence[float] | None = None,
        *,
        transition_time: float = 0.0,
        confirm: float | None = 1.0,
    ) -> None:
        """Set the payload of the arm. Motions and a running program continue.

        Args:
            mass: Mass in kg, at most 25 % above the payload in the data sheet of the arm. A UR5e has the limit of the
                UR7e, because both arms report the same robot type. The result of `measure_payload` sets its mass and
                its centre of gravity.
            cog: Centre of gravity in the flange frame, shape (3,), in m, each coordinate within 1 m. CB2 has no such
                setting.
            inertia: Moments of inertia about the centre of gravity: xx, yy, zz, xy, xz, yz, in kg m². Firmware 5.10 or
                later.
            transition_time: Duration of the change to the new payload, in seconds. A gradual change avoids a jerk when
                the arm grips or releases an object. Requires `cog`, `inertia`, and firmware 5.10 or later.
            confirm: Longest time after the transition to wait until the robot's states show the payload, in seconds.
                Firmware before 5.10 does not show the payload. With None, the call does not wait.

        Raises:
            BadValue: If a number is out of range, this firmware does not support the setting, or a measured centre is
                unknown. Nothing is sent.
            NotRunning: If the robot is not running, or its state is unknown. Nothing is sent.
            NotConfirmed: If the robot does not show the payload in time. The message names the likely cause: an
                e-Series in local control.
            LocalError: If called in a callback subscribed with ``inline=True``, unless `confirm` is None.
        """
        from .arm.payload import MeasuredPayload

        if isinstance(mass, MeasuredPayload):
            if cog is not None:
                raise BadValue("cog was given together with a measured payload, which has its own centre of gravity")
            mass, cog = mass.setting
        self._commanded().settings.payload(mass, cog, inertia, confirm, transition_time)

    def measure_payload(
        self,
        wrists: ArrayLike,
        *,
        may_move: bool = False,
        box: ArrayLike | None = None,
        postures: int = 8,
        speed: float = 0.3,
        acceleration: float = 0.5,
        rest: float = 1.0,
        set_payload: Sequence[float] | None = None,
        gravity: Sequence[float] = (0.0, 0.0, 9.82),
        timeout: float = 300.0,
        on_posture: Callable[[int], object] | None = None,
    ) -> MeasuredPayload:
        """Measure mass, centre of gravity and offset of the force sensor. **The arm moves.**

        The wrist joints turn the tool to several postures, and back to the current one. The other joints stay at their
        positions. The readings are those of the force sensor in the wrist (e-Series and later). Arms of CB3 have no
        such sensor. For these arms, the readings are the joint currents, and the intervals are wider. Nothing except
        the payload may touch the tool. Collisions are not checked.

        If the call is refused because of `may_move`, the message names the part of the space through which the TCP
        moves.

        Args:
            wrists: Largest angles of wrists 1, 2 and 3 from the current posture, one number or shape (3,), in rad.
            may_move: Consent that the arm moves automatically within these limits.
            box: Lower and upper corner of a box in the base frame, shape (2, 3), in m, that the TCP and the flange do
                not leave; None for no box.
            postures: Number of postures, 6 to 10.
            speed: Speed of the wrist that moves furthest, in rad/s.
            acceleration: Acceleration of this wrist, in rad/s².
            rest: Time of each reading, in s.
            set_payload: Mass in kg and centre in m, four numbers, that are set on the controller. It is needed on
                firmware before 5.10, which does not show them in each state.
            gravity: See `set_gravity`.
            timeout: Maximum time for the measurement, in s.
            on_posture: Function that is called with the number of each posture after its reading, in this thread.

        Raises:
            BadValue: If `may_move` is not True, an argument is invalid, or no postures within the limits determine the
                payload. Nothing is sent. Also raised after the motion if the readings do not determine it; the message
                names the quantity and the kind of posture that helps.
            Cancelled: If a program runs or is paused, the arm moves, or a limit was exceeded. The arm brakes.
            LinkTimeout: If the measurement does not end in time. The arm brakes.
            SafetyStop, NotRunning: If the arm may not be moved now.
        """
        measurement = self._payload_measurement(postures, rest, set_payload, gravity, timeout, on_posture)
        return measurement.automatic(wrists, box, speed, acceleration, may_move)

    def measure_payload_by_hand(
        self,
        *,
        postures: int = 8,
        rest: float = 1.0,
        posture_timeout: float = 60.0,
        set_payload: Sequence[float] | None = None,
        gravity: Sequence[float] = (0.0, 0.0, 9.82),
        timeout: float = 600.0,
        on_posture: Callable[[int], object] | None = None,
        watchdog: float = 0.5,
        link: LinkName = "reverse",
    ) -> MeasuredPayload:
        """Measure the payload in postures to which a person moves the arm in freedrive.

        A reading begins when the arm is at rest, and the tool has turned by 20 degrees or more from all earlier
        postures. The person must then release the tool, because a hand on it would be measured as well. The arm needs a
        force sensor.

        Args:
            postures, rest, set_payload, gravity, timeout: See `measure_payload`.
            posture_timeout: Maximum time until the next posture is read, in s.
            on_posture: Function that is called with the number of each posture after its reading, in this thread.
            watchdog, link: See `freedrive`.

        Raises:
            BadValue: If an argument is invalid, or the postures do not determine the payload; see `measure_payload`.
            LocalError: If the arm has no force sensor. See also `freedrive`.
            LinkTimeout: If a posture does not come in time. Freedrive ends.
            Cancelled, SafetyStop, NotRunning: See `measure_payload`.
        """
        measurement = self._payload_measurement(postures, rest, set_payload, gravity, timeout, on_posture)
        return measurement.by_hand(lambda: self.freedrive(watchdog=watchdog, link=link), posture_timeout)

    def _payload_measurement(
        self,
        postures: int,
        rest: float,
        set_payload: Sequence[float] | None,
        gravity: Sequence[float],
        timeout: float,
        on_posture: Callable[[int], object] | None,
    ) -> PayloadMeasurement:
        from .motion.payload_measurement import PayloadMeasurement

        arm = self.kinematics
        return PayloadMeasurement(
            self.motion,
            self.realtime,
            self.primary,
            arm,
            arm.model.generation == "e",
            postures=postures,
            rest=rest,
            set_payload=set_payload,
            gravity=gravity,
            timeout=timeout,
            on_posture=on_posture,
        )

    def wrench(self, payload: MeasuredPayload, frame: Numbers | str = "tcp") -> WrenchStream:
        """Return a stream of the wrench on the tool, without the weight of the payload and the offset of the sensor.

        The wrench is what the surroundings exert on the tool, in N and Nm. The raw wrench is next to it. If the payload
        on the controller changes (`set_payload`), the stream follows it on firmware 5.10 or later. After `set_tcp`,
        make a new stream. After the sensor was zeroed, call `zero` of the stream.

        Args:
            payload: Result of `measure_payload` or `measure_payload_by_hand` on an arm with a force sensor.
            frame: "tcp" for the TCP and its axes; "base" for the axes of the base and torques about the TCP, as in
                `tcp_force`; or a pose in the base frame, shape (6,), for its axes and torques about its origin.

        Raises:
            BadValue: If the frame is invalid, or the payload was measured without a force sensor.
            LocalError: If the arm is unknown.
            LinkTimeout, RemoteError: If no state arrives, so that the TCP is unknown.
        """
        from .motion.wrench import WrenchStream

        return WrenchStream(self.realtime, self.kinematics, payload, frame)

    def set_gravity(self, acceleration: Sequence[float]) -> None:
        """Set the direction of gravity, for an arm on a wall, a ceiling or a moving base. Motions continue.

        The controller uses this direction to compensate for the weight of the arm. With a wrong direction, the arm sags
        or jumps, or stops with a safety stop. No state shows the setting, so it is not confirmed. An e-Series in local
        control ignores the setting.

        Args:
            acceleration: Acceleration that an arm at rest measures, shape (3,), in m/s², in the base frame. The vector
                points upwards: [0, 0, 9.82] for an upright arm. Its norm must be 5 to 15 m/s².

        Raises:
            BadValue: If `acceleration` is not such a vector. Nothing is sent.
            NotRunning: If the robot is not running, or its state is unknown. Nothing is sent.
        """
        self._commanded().settings.gravity(acceleration)

    def set_tcp(self, pose: Sequence[float], *, confirm: float | None = 1.0) -> None:
        """Set the tool centre point (TCP) to a pose in the flange frame: position in m, rotation vector in rad.

        Firmware 3.2 or later shows the TCP in its states, so the call can confirm the setting.

        Raises:
            BadValue, NotRunning, NotConfirmed, LocalError: See `set_payload`.
        """
        self._commanded().settings.tcp(pose, confirm)

    def set_speed_slider(self, fraction: float, *, confirm: float | None = 1.0) -> None:
        """Set the speed slider to a fraction from 0 to 1.

        Firmware 3.0 or later shows the slider in its states, so the call can confirm the setting.

        Raises:
            BadValue, NotRunning, NotConfirmed, LocalError: See `set_payload`.
        """
        self._commanded().settings.speed_slider(fraction, confirm)

    def freedrive(
        self,
        axes: Sequence[object] | None = None,
        *,
        frame: Numbers | str = "base",
        watchdog: float = 0.5,
        link: LinkName = "reverse",
    ) -> Freedrive:
        """Let a person move the arm by hand while a ``with`` block runs::

            with robot.freedrive():
                input("move the arm, then press Enter")

        The payload must be correct (`set_payload`), otherwise the arm drifts. Freedrive ends when the block ends, for
        any reason. If messages from this computer stop arriving, the program on the robot ends freedrive on its own.

        Args:
            axes: Free axes x, y, z, rx, ry, rz of the frame, as six values of 0 or 1; None for all axes. Firmware 5.10
                or later.
            frame: Frame of the axes: "base", "tool" (the current tool frame), or a pose in the base frame, shape (6,).
            watchdog: Longest time without a message from this computer, in seconds. After this time, the arm stops.
            link: See `Motions.follow`.

        Raises:
            BadValue: If the axes or the frame are invalid.
            LocalError: If programs cannot use freedrive on this firmware, or cannot select its axes.
        """
        return self.motion._freedrive(axes, frame, watchdog, link)

    def teach(
        self,
        *,
        digital_input: int | None = None,
        bank: Literal["standard", "configurable", "tool"] = "standard",
        button: bool = False,
        on_point: Callable[[TaughtPoint], object] | None = None,
        axes: Sequence[object] | None = None,
        frame: Numbers | str = "base",
        watchdog: float = 0.5,
        link: LinkName = "reverse",
    ) -> Teaching:
        """Save waypoints while a person moves the arm, until a ``with`` block ends::

            with robot.teach(digital_input=0) as teaching:
                while input("Enter keeps a waypoint, q ends: ") != "q":
                    teaching.record()
            teaching.taught.save("pick.json")
            teaching.taught.play(robot, wait=True)

        Args:
            digital_input: Number of an input that saves a waypoint each time it is switched on.
            bank: Bank of the digital input: "standard", "configurable" or "tool".
            button: If True, the person presses the freedrive button of the arm to move it. Each release of the button
                saves a waypoint. No program runs in this case. RTDE is required.
            on_point: Function that is called with each waypoint, in the thread that saved it.
            axes, frame, watchdog, link: See `freedrive`.

        Raises:
            BadValue: If the input does not exist. See also `freedrive`.
            LocalError: If `button` is True and the firmware has no RTDE. See also `freedrive`.
        """
        from .motion.teaching import Teaching
        from .script import commands

        banks = {each.name: each for each in (commands.STANDARD, commands.CONFIGURABLE, commands.TOOL)}
        check_choice(bank, "bank", tuple(banks))
        if on_point is not None:
            check_callable(on_point, "on_point")
        bit = None if digital_input is None else banks[bank].bit(self.firmware, digital_input, "input")
        buttons = self.rtde.outputs("robot_status_bits") if button else None
        mode = None if button else self.freedrive(axes, frame=frame, watchdog=watchdog, link=link)
        return Teaching(self.realtime, self.model, mode, bit, buttons, on_point or (lambda point: None))

    @property
    def points(self) -> Points:
        """Taught points by name, in the file that was passed to `connect` as ``points=``. See `Points`.

        Raises:
            LocalError: If `connect` got no file.
        """
        if self._points_path is None:
            raise LocalError(
                f"no file for points was given; connect with points=, as in urlink.connect({self.address!r}, "
                "points='cell.json')"
            )
        known = self._points.made
        if known is not None:
            return known
        from .motion.points.point_file import PointFile
        from .motion.points.points import Points

        return self._points.keep(Points(PointFile(self._points_path), self.realtime, self._who))

    def zero_force_sensor(self) -> None:
        """Zero the force sensor: the current force at the TCP becomes zero. Firmware 3.0 or later.

        Nothing should touch the tool during the call. The controller zeroes the sensor within a few cycles, but no
        state shows that it has done so.

        Raises:
            LocalError: If the firmware is older than 3.0.
            NotRunning: If the robot is not running, or its state is unknown. Nothing is sent.
        """
        self._commanded().settings.zero_force_sensor()

    def popup(self, text: str, title: str = "Popup", *, warning: bool = False, error: bool = False) -> None:
        """Show a text on the pendant, without waiting.

        The controller does not report whether the text is shown or read.

        Raises:
            BadValue: If the text contains quotes, backslashes or line breaks. Nothing is sent.
            NotRunning: See `set_payload`.
        """
        self._commanded().settings.popup(text, title, warning, error)

    def _commanded(self) -> Control:
        known = self._control.made
        if known is not None:
            return known
        if self._make_control is None:
            raise LocalError(self._refusal)
        control = self._control.keep(self._make_control(self))
        if self._is_closed:
            # `close` might have run before this object existed. Closing twice is harmless.
            control.close(0.0)
        return control

    def view(
        self,
        *,
        plots: Sequence[str] = ("qd_actual", "tcp_force"),
        urdf: str | os.PathLike[str] | None = None,
        jog: bool = False,
        port: int = 0,
    ) -> View:
        """Show the arm in 3D in a browser on this computer, or in a cell of a notebook.

        The view runs until it is closed, or until its ``with`` block is left. The package ``urlink-view`` is required.

        Args:
            plots: Names of the `RealtimeState` fields to plot.
            urdf: URDF file with meshes for the links; None draws cylinders and spheres.
            jog: Whether to show buttons that move the arm while they are pressed.
            port: Port of the page; 0 for a free port.

        Raises:
            BadValue: If a field does not exist.
            ConnectFailed: If the port cannot be opened.
            LocalError: If the package is not installed, the model is unknown, or the file cannot be drawn.
            RemoteError: If the robot cannot be reached.
        """
        show = plugin("urlink.robot", "view", "urlink-view", "a view in a browser")
        shown: View = show(self, plots, urdf, jog, port)
        return shown

    # -- closing -------------------------------------------------------------------------------------

    def close(self, timeout: float = 2.0) -> None:
        """End motions, and close all streams and the simulator, within `timeout` seconds. Idempotent.

        In a forked process the call does nothing, because motions and connections belong to the parent process.
        """
        if not self._home.is_here:
            return
        until = clock.now() + timeout
        self._is_closed = True
        if (control := self._control.made) is not None:
            control.close(timeout)
        if (rtde := self._rtde.made) is not None:
            rtde.close(clock.left(until))
        for stream in list(self._streams.values()):
            stream.close(clock.left(until))
        if self._controller is not None:
            self._controller.close()

    def __del__(self) -> None:
        # Each stream that was not closed issues its own warning.
        if not getattr(self, "_is_closed", True) and self._controller is not None:
            warnings.warn(
                f"{self!r} was not closed; its simulator still runs", ResourceWarning, source=self, stacklevel=2
            )

    def _repr_html_(self) -> str:
        known = self._who.last
        streams = list(self._streams.items())
        opened = ", ".join(name for name, _ in streams) or "none; the first use of robot.realtime connects it"
        who = html_table(
            self.address, (), [("model", known.model), ("firmware", known.firmware), ("open streams", opened)]
        )
        rows = [
            (name, stream.connection.value, f"{stream.stats.rate:.0f} Hz", stream.stats.received)
            for name, stream in streams
        ]
        return who + (html_table("streams", ("stream", "connection", "rate", "received"), rows) if rows else "")

    def __repr__(self) -> str:
        known = self._who.last
        return f"<Robot {self.address} {known.model} firmware {known.firmware}>"

    def _stream(self, name: str) -> Stream[Any]:
        known = self._streams.get(name)
        if known is None:
            made = self._source.stream(name, f"{self.address} {name}", self._who.doubt)
            known = self._streams.setdefault(name, made)
            if self._is_closed:
                known.close(0.0)  # `close` ran before this stream existed; from now on, connecting raises `Closed`
        return known


def _rtde_of(robot: Robot) -> Callable[[], Rtde]:
    """Return a function that gives the RTDE client of a robot, without keeping the robot alive."""
    held = weakref.ref(robot)

    def rtde() -> Rtde:
        alive = held()
        if alive is None:
            raise Closed("the robot was closed")
        return alive.rtde

    return rtde


def _recorder(path: str | os.PathLike[str]) -> Recorder:
    """Return the recorder for a file, according to its suffix."""
    from linkcore.recording.table_files import format_of

    kind = format_of(path)
    if kind is not None and not kind.is_live:
        suffix = PurePath(path).suffix.lower()
        raise BadValue(f"{os.fspath(path)}: {suffix} cannot be written live; record a .urlog file and export it")
    if kind is not None:
        recorder: Recorder = plugin("urlink.recorders", "mcap", "urlink-view", "recording an .mcap file live")(path)
        return recorder
    from linkcore.recording.recorder import Recorder

    return Recorder(path)

"""`connect()`, and `Robot`, the object that users hold."""

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
from .session.source import Source, networked, recorded

if TYPE_CHECKING:
    from typing_extensions import Self

    from linkcore.recording.recorder import Recorder

    from .arm.kinematics import Arm
    from .arm.vectors import Numbers
    from .command.interpreter import Interpreter
    from .command.io import IO
    from .command.safety import Safety
    from .command.scripts import Scripts
    from .motion import Freedrive, Motions
    from .motion.control import Control
    from .motion.motions import LinkName
    from .motion.teaching import TaughtPoint, Teaching
    from .protocol.dashboard.client import Dashboard
    from .protocol.gripper.client import Gripper
    from .protocol.tool_serial import ToolSerial
    from .rtde import OutputStream, Registers, Rtde
    from .simulator import Controller


class View(Protocol):
    """An arm on a page, as the package ``urlink-view`` shows it. A context manager."""

    @property
    def address(self) -> str:
        """The address for browsers."""

    def close(self) -> None:
        """Show no more; idempotent."""

    def __enter__(self) -> Self: ...

    def __exit__(self, *exc: object) -> None: ...


@takes_connect_options
def connect(options: ConnectOptions) -> Robot:
    """Connect to a robot, to the simulator, or to a recording.

    Asks the controller who it is; the streams themselves connect when first used. What this process gave up at the same
    address before, and may still be carried out, is undone first, for at most `timeout` seconds; see
    docs/motion-ends.md, "What was given up is not carried out". A connection with `read_only` takes nothing back.

    Args:
        address: ``"192.168.56.101"``, ``"ur://host"``, ``"sim://ur5e?firmware=5.11"``,
            ``"replay:///path/run.urlog?rate=2"``, or a recording by its path: ``"run.urlog"``, or any `pathlib.Path`.
        timeout: seconds for any connection to be made.
        read_only: use the ports that take no commands, 30011 to 30013.
        backoff: how streams reconnect.
        silence: seconds without a packet after which a stream counts as disconnected.
        require_enable: whether `robot.safety.enable()` has to be called before the arm can be moved: "never",
            "on_startup" (once) or "always" (at first and after every stop).
        stale_after: seconds without a packet of the robot after which motions end with `NotRunning`, and new ones are
            refused.
        start_timeout: seconds that a program that was uploaded has to begin. One that begins later finds nobody who
            lets it go on, and ends without moving the arm.
        start_register: number of the output register for integers, 0 to 47, in which a program finds its permission to
            go on. Every client of this library may use the same one, and nobody else. None takes the flags instead.
        start_flags: numbers of flags, 0 to 31, used likewise on firmwares before 3.9 and 5.3, which lack the register:
            the more flags, the less likely it is that another client's permission starts a program that was given up.
            With neither register nor flags each program begins as soon as the controller reads it, however late that
            is: a motion whose handle has failed long ago can still be carried out then.
        reverse_host: address at which the robot finds this computer, for set-points that are streamed; None to find
            it out by the route to the robot.
        reverse_port: port that it finds there; 0 for a free one.
        reverse_peer: address that the robot's connections come from; None for the one that it was connected by. A
            simulator in a container may come from another.
        commands_via: how outputs and the speed slider are set: "auto" over RTDE where the controller has it and nobody
            else holds the inputs, and by script otherwise; "script" never claims an input of RTDE.
        isolate: a process of its own reads the real-time interface: the newest state is there whenever it is asked for,
            also in a program that holds the interpreter's lock for long. Not on Windows.

    Raises:
        BadAddress: nobody can read the address.
        BadRecording: the recording does not exist, or is not one.
        BadValue: a time that is not positive, no such policy or port, or a simulated arm that does not run the
            firmware.
        UnknownModel: no such arm to simulate.
        ConnectFailed, ConnectionLost, LinkTimeout, WrongPeer: nobody, or somebody else, is there.
    """
    if isinstance(options.place, RecordingAddress):
        refusal = f"{options.name} is a recording, so it cannot be commanded"
        return Robot(options.name, recorded(options.place), refusal=refusal)
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
    """A simulated controller that serves, and where it is.

    Raises:
        UnknownModel, BadValue: no such arm, it does not run the firmware, the file is not of such an arm, or there is
            no file of a scene.
        LocalError: no adapter for the scene is installed, or it cannot open it.
    """
    from .arm.arm_file import read_arm_file
    from .simulator import Controller, Demonstration

    like = None if place.like is None else read_arm_file(place.like)
    motion = Demonstration() if place.motion == "demo" else None
    controller = Controller(model=place.model, firmware=place.firmware, motion=motion, like=like, scene=place.scene)
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
    """A robot on the network, with what commands it.

    Args:
        known: its identity, if known; None to ask.

    Raises:
        RemoteError: nobody, or somebody else, is there.
    """
    address = options.name

    def control(robot: Robot) -> Control:
        # A program that only reads states never imports what commands: more than all the rest of this library.
        from .motion.control import Control

        peers = peers_of(place) if controller is None else ()
        return Control(options, place, peers, robot.primary, robot.realtime, robot._who, _rtde_of(robot))

    if options.read_only:
        refusal = f"{address} was connected with read_only=True, so it cannot be commanded"
        return Robot(address, source, controller, refusal=refusal, known=known)
    return Robot(address, source, controller, known=known, control=control)


def peers_of(place: RobotAddress) -> tuple[Hashable, ...]:
    """By what this process knows a controller again, and each of the services that can be used without a robot."""
    services = ("dashboard", "robot_api", "gripper")
    parts = (service_of(place.host, place.ports[name]) for name in services if name in place.ports)
    return (place.host.casefold(), frozenset(place.ports.items())), *parts


def owes(robot: Robot, place: RobotAddress) -> bool:
    """This process gave something up at that controller that may still be carried out, and the robot may command it."""
    return robot._make_control is not None and PendingUndos.is_owed(*peers_of(place))


def undo_abandoned(robot: Robot, timeout: float) -> None:
    """Wait until that is undone, at most `timeout` seconds; the robot goes on with it while it is open."""
    robot._commanded().settle(timeout)


class Robot(StrictAttributes, Closing):
    """A robot: its streams, and what it is. A context manager that closes itself; made by `connect`.

    Attributes:
        address: what it was connected by.
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
    ) -> None:
        self.address = address
        self._controller = controller
        self._make_control = control
        self._control: MadeOnce[Control] = MadeOnce()
        self._refusal = refusal
        self._source = source
        self._who = KnownIdentity(source.ask, known)
        #: changed in single steps, so that a signal handler finds it whole
        self._streams: dict[str, Stream[Any]] = {}
        self._rtde: MadeOnce[Rtde] = MadeOnce()
        self._registers: MadeOnce[Registers] = MadeOnce()
        self._home = HomeProcess(address)
        self._is_closed = False

    # -- what it says ------------------------------------------------------------------------------

    @property
    def realtime(self) -> Stream[RealtimeState]:
        """Stream of `RealtimeState`, 125 or 500 Hz (port 30003)."""
        return self._stream("realtime")

    @property
    def primary(self) -> Stream[RobotState]:
        """Stream of `RobotState` at 10 Hz; with `of` or a class, of its parts and of messages (port 30001)."""
        return self._stream("primary")

    @property
    def secondary(self) -> Stream[RobotState]:
        """As `primary`, without messages but the version (port 30002)."""
        return self._stream("secondary")

    @property
    def clock(self) -> RobotClock:
        """The controller's clock beside this computer's, by the real-time stream."""
        return RobotClock(self.realtime, self._who)

    @property
    def rtde(self) -> Rtde:
        """Variables of the controller by name, up to 500 times a second, read and written (port 30004)."""
        rtde = self._rtde.made
        if rtde is None:
            from .rtde import Rtde

            who = self._who  # and not this object, which holds the made one
            made = Rtde(self.address, self._source, lambda: who.identity.firmware, refusal=self._refusal)
            rtde = self._rtde.keep(made)
            if self._is_closed:
                rtde.close(0.0)
        return rtde

    @property
    def registers(self) -> Registers:
        """General-purpose registers by number, shared with the program on the controller."""
        return self._registers.made or self._registers.keep(self.rtde.registers())

    @property
    def firmware(self) -> Firmware:
        """The controller's firmware.

        After a reconnect the controller is asked again on first access, since it may have come back
        with another firmware; that can raise what `connect` raises.
        """
        return self._who.identity.firmware

    @property
    def model(self) -> str | None:
        """Name of the arm, such as "UR5e"; None if the controller does not say. See `firmware`."""
        return self._who.identity.model

    @property
    def identity(self) -> Identity:
        """All that is known of who the controller is. See `firmware`."""
        return self._who.identity

    @property
    def kinematics(self) -> Arm:
        """Forward and inverse kinematics of this very arm, in the base frame of the controller.

        The controller sends its own DH parameters as a connection begins (1.8 and later); with them, the arm computes
        as the controller does (`Arm.is_calibrated`). Where they did not come, or in a recording without them, it is the
        published arm of that model. The TCP that is set on the controller is not part of it: pass it as ``tcp=``.

        After a reconnect the controller is asked again on first access, as for `firmware`.

        Raises:
            LocalError: the controller does not say which arm it has, or nobody knows it.
            WrongPeer: it sends DH parameters that are not those of its arm.
        """
        return self._who.identity.kinematics

    @property
    def controller(self) -> Controller:
        """The simulator behind ``sim://``: its faults, its inputs, its arm.

        Raises:
            LocalError: `connect` does not simulate this robot.
        """
        if self._controller is None:
            raise LocalError(f"{self.address} is no simulator of this program; connect to sim:// for one")
        return self._controller

    def record(
        self, path: str | os.PathLike[str], interfaces: Sequence[str | OutputStream[Any]] = ("realtime", "primary")
    ) -> Recorder:
        """Record streams into a new file, from now until the recorder is closed.

        Args:
            path: of the file. One that ends in .mcap gets messages of ROS 2, for Foxglove and `ros2 bag`; every other
                one a recording, from which `urlink.load` makes all formats.
            interfaces: "realtime", "primary", "secondary", or a stream that `Rtde.outputs` has made, of which there
                may be one.

        Raises:
            BadRecording: the file exists, or cannot be made.
            BadValue: no such interface, two streams of RTDE, or a format that cannot be written live.
            LocalError: .mcap, and the package ``urlink-view`` is not installed.
            RemoteError: a stream could not be opened.
        """
        streams = [("rtde", each) if isinstance(each, Stream) else (each, self._stream(each)) for each in interfaces]
        if len({name for name, _ in streams}) < len(streams):
            raise BadValue(f"recorded twice: {', '.join(name for name, _ in streams)}; expected each once")
        recorder = _recorder(path)
        try:
            for name, stream in streams:
                recorder.add(
                    stream,
                    {"name": name, "address": self.address, **self.identity.description(), **stream.description()},
                )
        except BaseException:
            # A robot that is away leaves no file behind.
            recorder.close()
            recorder.path.unlink(missing_ok=True)
            raise
        return recorder

    # -- commands -----------------------------------------------------------------------------------

    @property
    def safety(self) -> Safety:
        """The interlock between motions and the arm. All of these raise `LocalError` where commands cannot be sent."""
        return self._commanded().safety

    @property
    def script(self) -> Scripts:
        """Sends programs and lines of URScript."""
        return self._commanded().script

    @property
    def io(self) -> IO:
        """Inputs and outputs."""
        return self._commanded().io

    @property
    def motion(self) -> Motions:
        """Moves the arm."""
        return self._commanded().motion

    @property
    def dashboard(self) -> Dashboard:
        """Power, brakes, installed programs, and unlocking after a protective stop."""
        return self._commanded().dashboard

    def interpreter(
        self,
        *,
        start_timeout: float = 10.0,
        finish_timeout: float = 60.0,
        on_text: Callable[[str], object] | None = None,
    ) -> Interpreter:
        """Begin interpreter mode, in which statements of URScript are executed one by one as they are handed over.

        It sends a program, which preempts the one that runs, and returns once that takes statements. From 5.10 on.

        Args:
            start_timeout: seconds for that.
            finish_timeout: seconds that statements may still take where the block of a ``with`` is left.
            on_text: called with each line of `textmsg`, in the robot's thread for callbacks.

        Raises:
            BadValue: not a time.
            LocalError: the firmware has no interpreter mode.
            SafetyStop, NotRunning: the arm may not be moved now: nothing was sent.
            LinkTimeout: it has not begun in time; nothing of it is left behind.
            LinkError: it could not be begun, or what has ended it meanwhile.
        """
        return self._commanded().interpreters.begin(start_timeout, finish_timeout, on_text)

    @property
    def gripper(self) -> Gripper:
        """A Robotiq gripper whose URCap runs on the controller (port 63352). Nothing of it is interlocked."""
        return self._commanded().gripper

    @property
    def tool_serial(self) -> ToolSerial:
        """The RS485 line in the tool connector of an e-Series, which a URCap forwards (port 54321). Not interlocked.

        Raises:
            LocalError: a controller that has none.
        """
        return self._commanded().tool_serial

    def set_payload(
        self,
        mass: float,
        cog: Sequence[float] | None = None,
        inertia: Sequence[float] | None = None,
        *,
        transition_time: float = 0.0,
        confirm: float | None = 1.0,
    ) -> None:
        """Tell what the arm carries; motion, and a program that runs, go on.

        Args:
            mass: kg; no more than a quarter above what the arm carries by its data sheet, which for a UR5e is that of
                the UR7e: it reports the same type.
            cog: centre of gravity in the flange's frame, (3,), m, each within 1 m; not on CB2.
            inertia: about it: xx, yy, zz, xy, xz, yz, kg m²; from 5.10 on.
            transition_time: s over which the controller goes over to it, so that an arm that grips or lets go does not
                jerk; with `cog` and `inertia`, from 5.10 on.
            confirm: seconds after that within which the robot has to show it, from 5.10 on; before that nothing shows
                it. None does not wait.

        Raises:
            BadValue: a number out of range, or what this firmware cannot be set to; nothing was sent.
            NotRunning: the robot does not run, or nothing is known of it; nothing was sent.
            NotConfirmed: the robot does not show it. The likely cause is in the message: an e-Series in local control.
            LocalError: in a callback that was subscribed with ``inline=True``, unless `confirm` is None.
        """
        self._commanded().settings.payload(mass, cog, inertia, confirm, transition_time)

    def set_gravity(self, acceleration: Sequence[float]) -> None:
        """Set which direction is up, for an arm on a wall, a ceiling or a base that moves; motion goes on.

        The controller holds the arm up by this: with a wrong one, the arm sags or jumps, or stops with a safety
        stop. No state shows it, so it is not confirmed, and in local control an e-Series ignores it.

        Args:
            acceleration: (3,) m/s² in the base frame, of an arm at rest: upwards, [0, 0, 9.82] for one that stands, and
                5 to 15 long.

        Raises:
            BadValue: not that; nothing was sent.
            NotRunning: the robot does not run, or nothing is known of it; nothing was sent.
        """
        self._commanded().settings.gravity(acceleration)

    def set_tcp(self, pose: Sequence[float], *, confirm: float | None = 1.0) -> None:
        """Put the tool centre point at a pose in the flange's frame: m, and rotation vector in rad.

        It shows from 3.2 on.

        Raises:
            BadValue, NotRunning, NotConfirmed, LocalError: as `set_payload`.
        """
        self._commanded().settings.tcp(pose, confirm)

    def set_speed_slider(self, fraction: float, *, confirm: float | None = 1.0) -> None:
        """Move the speed slider, 0 to 1. It shows from 3.0 on.

        Raises:
            BadValue, NotRunning, NotConfirmed, LocalError: as `set_payload`.
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
        """Let a person move the arm by hand, for as long as a block::

            with robot.freedrive():
                input("move the arm, then press Enter")

        The payload has to be right (`set_payload`), or the arm drifts. Whatever ends the block ends freedrive; where
        nothing arrives from this computer any more, the program on the robot does so by itself.

        Args:
            axes: six of 0 and 1, x, y, z, rx, ry, rz of the frame: the free ones; None for all. From 5.10 on.
            frame: "base", "tool" (where the tool is now), or a (6,) pose in the base frame.
            watchdog: seconds without a message from this computer after which the arm stands.
            link: see `Motions.follow`.

        Raises:
            BadValue: no such axes or frame.
            LocalError: this firmware has no freedrive for programs, or none along chosen axes.
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
        """Keep waypoints while a person moves the arm, for as long as a block::

            with robot.teach(digital_input=0) as teaching:
                while input("Enter keeps a waypoint, q ends: ") != "q":
                    teaching.record()
            teaching.taught.save("pick.json")
            teaching.taught.play(robot, wait=True)

        Args:
            digital_input: number of an input that keeps a waypoint each time that it is switched on.
            bank: which digital inputs that is one of.
            button: the arm is moved with its own freedrive button held, and each time that it is let go keeps a
                waypoint; no program runs then. Needs RTDE.
            on_point: called with each waypoint, in the thread that has kept it.
            axes, frame, watchdog, link: see `freedrive`.

        Raises:
            BadValue: there is no such input, or as `freedrive`.
            LocalError: as `freedrive`; or with `button`, the firmware has no RTDE.
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

    def zero_force_sensor(self) -> None:
        """Take what the force at the TCP is now for zero, from 3.0 on. Nothing should touch the tool then; nothing
        shows when it has happened, which is within a few cycles.

        Raises:
            LocalError: firmware before 3.0.
            NotRunning: the robot does not run, or nothing is known of it; nothing was sent.
        """
        self._commanded().settings.zero_force_sensor()

    def popup(self, text: str, title: str = "Popup", *, warning: bool = False, error: bool = False) -> None:
        """Show a text on the pendant, without waiting; the controller does not report whether it is shown or read.

        Raises:
            BadValue, NotRunning: as `set_payload`. A text can hold no quotes, backslashes or line breaks.
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
            # `close` may have looked for it before it was there; closing twice does no harm.
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
        """Show the arm in 3D in a browser of this computer; a notebook shows it in the cell.

        It goes on until it is closed, or the block of a ``with`` is left. The package ``urlink-view`` is needed.

        Args:
            plots: names of fields of `RealtimeState` to draw as curves.
            urdf: a file with bodies for the links, as meshes; None for cylinders and spheres.
            jog: show buttons that move the arm while they are held; otherwise it is only watched.
            port: to serve the page at; 0 for a free one.

        Raises:
            BadValue: there is no such field.
            ConnectFailed: the port cannot be listened on.
            LocalError: the package is not installed, the model is unknown, or the file cannot be drawn.
            RemoteError: the robot cannot be connected to.
        """
        show = plugin("urlink.robot", "view", "urlink-view", "a view in a browser")
        shown: View = show(self, plots, urdf, jog, port)
        return shown

    # -- its end -------------------------------------------------------------------------------------

    def close(self, timeout: float = 2.0) -> None:
        """End motions, close every stream, and the simulator if there is one; in `timeout` seconds. Idempotent.

        In a forked process this does nothing: motions and connections are its parent's.
        """
        if not self._home.is_here:
            return
        until = clock.now() + timeout
        self._is_closed = True
        if (control := self._control.made) is not None:
            control.close(timeout)
        if (rtde := self._rtde.made) is not None:
            rtde.close(clock.left(until))
        for stream in tuple(self._streams.values()):
            stream.close(clock.left(until))
        if self._controller is not None:
            self._controller.close()

    def __del__(self) -> None:
        # The streams warn for themselves.
        if not getattr(self, "_is_closed", True) and self._controller is not None:
            warnings.warn(f"{self!r} was not closed; its simulator goes on", ResourceWarning, source=self, stacklevel=2)

    def _repr_html_(self) -> str:
        known = self._who.last
        streams = tuple(self._streams.items())
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
                known.close(0.0)  # `close` has not seen it; what would connect raises `Closed`
        return known


def _rtde_of(robot: Robot) -> Callable[[], Rtde]:
    """A function that returns the RTDE of a robot, and does not keep the robot alive."""
    held = weakref.ref(robot)

    def rtde() -> Rtde:
        alive = held()
        if alive is None:
            raise Closed("the robot was closed")
        return alive.rtde

    return rtde


def _recorder(path: str | os.PathLike[str]) -> Recorder:
    """The recorder for a file, by its suffix."""
    from linkcore.recording.table_files import format_of

    kind = format_of(path)
    if kind is not None and not kind.is_live:
        suffix = PurePath(path).suffix.lower()
        raise BadValue(f"{os.fspath(path)}: {suffix} is not written live; record a .urlog, and export it")
    if kind is not None:
        recorder: Recorder = plugin("urlink.recorders", "mcap", "urlink-view", "recording an .mcap file live")(path)
        return recorder
    from linkcore.recording.recorder import Recorder

    return Recorder(path)

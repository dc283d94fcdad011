"""`connect()` and `Robot`: what the user holds."""

from __future__ import annotations

import os
import threading
import time
import weakref
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, get_args

from linkcore.errors import BadValue, LocalError
from linkcore.recording.recorder import Recorder
from linkcore.streaming.backoff import Backoff
from linkcore.streaming.stream import Stream

from .address import RecordingAddress, RobotAddress, SimulatorAddress, parse_address
from .commanding.control import Control
from .commanding.interlock import Policy
from .commanding.io import IO
from .commanding.programs import Scripts
from .commanding.safety import Safety
from .firmware import Firmware
from .identity import Identity
from .interfaces.primary.robot_state import RobotState
from .interfaces.realtime.packets import RealtimeState
from .models import MODELS
from .source import Source, networked, recorded
from .urscript import commands

if TYPE_CHECKING:
    from .interfaces.dashboard.client import Dashboard
    from .motion import Motions
    from .simulator import Controller

__all__ = ["Robot", "connect"]

#: Factor by which a mass may exceed the payload of the arm. Software updates have raised that of some arms by a quarter
#: (UR10e from 10 to 12.5 kg, UR20 from 20 to 25 kg); `urlink.models` has the latest figures, this leaves room for the
#: next.
_PAYLOAD_MARGIN = 1.25


def connect(
    address: str,
    *,
    timeout: float = 5.0,
    read_only: bool = False,
    backoff: Backoff | None = None,
    silence: float = 2.0,
    require_enable: Policy = "never",
    reverse_host: str | None = None,
    reverse_port: int = 0,
) -> Robot:
    """Connect to a robot, to the simulator, or to a recording.

    Asks the controller who it is; the streams themselves connect when first used.

    Args:
        address: ``"192.168.56.101"``, ``"ur://host"``, ``"sim://ur5e?firmware=5.11"``, or
            ``"replay:///path/run.urlog?rate=2"``.
        timeout: seconds for any connection to be made.
        read_only: use the ports that take no commands, 30011 to 30013.
        backoff: how streams reconnect.
        silence: seconds without a packet after which a stream counts as disconnected.
        require_enable: whether `robot.safety.enable()` has to be called before the arm can be moved: "never",
            "on_startup" (once) or "always" (at first and after every stop).
        reverse_host: address at which the robot finds this computer, for set-points that are streamed; None to find
            it out by the route to the robot.
        reverse_port: port that it finds there; 0 for a free one.

    Raises:
        BadAddress: nobody can read the address.
        BadRecording: the recording does not exist, or is none.
        BadValue: a time that is not positive, no such policy or port, or a simulated arm that does not run the
            firmware.
        UnknownModel: no such arm to simulate.
        ConnectFailed, ConnectionLost, LinkTimeout, WrongPeer: nobody, or somebody else, is there.
    """
    if not timeout > 0 or not silence > 0:
        raise BadValue(f"timeout={timeout}, silence={silence}; expected positive numbers of seconds")
    if require_enable not in get_args(Policy):
        raise BadValue(f"require_enable={require_enable!r}; expected one of {', '.join(get_args(Policy))}")
    if not 0 <= reverse_port < 65536:
        raise BadValue(f"reverse_port={reverse_port}; expected 0 to 65535")
    place = parse_address(address)
    if isinstance(place, RecordingAddress):
        return Robot(address, recorded(place), refusal=f"{address} is a recording, so it cannot be commanded")
    controller = None
    if isinstance(place, SimulatorAddress):
        from .simulator import Controller

        controller = Controller(model=place.model, firmware=place.firmware)
        controller.start()
        place = RobotAddress(controller.host, dict(controller.ports))
    try:
        source = networked(place, timeout=timeout, read_only=read_only, backoff=backoff, silence=silence)
        if read_only:
            refusal = f"{address} was connected with read_only=True, so it cannot be commanded"
            return Robot(address, source, controller, refusal=refusal)
        robot = Robot(address, source, controller)
        robot.control = Control(
            place.host,
            place.ports.get("dashboard"),
            lambda: robot.primary,
            lambda: robot.realtime,
            lambda: robot.identity,
            policy=require_enable,
            reverse_host=reverse_host,
            reverse_port=reverse_port,
            timeout=timeout,
        )
        return robot
    except BaseException:
        if controller is not None:
            controller.close()
        raise


class Robot:
    """A robot: its streams, and what it is. A context manager that closes itself; made by `connect`.

    Attributes:
        address: what it was connected by.
        controller: the simulator behind ``sim://``, or None.
        control: what it is commanded by, or None where it cannot be.
    """

    def __init__(
        self, address: str, source: Source, controller: Controller | None = None, *, refusal: str = ""
    ) -> None:
        self.address = address
        self.controller = controller
        self.control: Control | None = None
        self._refusal = refusal
        self._source = source
        self._identity = source.ask()
        self._is_stale = False
        self._streams: dict[str, Stream[Any]] = {}
        self._lock = threading.Lock()

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
    def firmware(self) -> Firmware:
        """The controller's firmware.

        After a reconnect the controller is asked again on first access, since it may have come back
        with another firmware; that can raise what `connect` raises.
        """
        return self._known().firmware

    @property
    def model(self) -> str | None:
        """Name of the arm, such as "UR5e"; None if the controller does not say. See `firmware`."""
        return self._known().model

    @property
    def identity(self) -> Identity:
        """All that is known of who the controller is. See `firmware`."""
        return self._known()

    def record(self, path: str | os.PathLike[str], interfaces: Sequence[str] = ("realtime", "primary")) -> Recorder:
        """Record streams into a new file, from now until the recorder is closed.

        Raises:
            BadRecording: the file exists, or cannot be made.
            BadValue: no such interface.
            RemoteError: a stream could not be opened.
        """
        streams = [(name, self._stream(name)) for name in interfaces]
        recorder = Recorder(path)
        try:
            for name, stream in streams:
                info = {"name": name, "address": self.address, "firmware": str(self.firmware), "model": self.model}
                recorder.add(stream, info)
        except BaseException:
            # A robot that is away leaves no file behind.
            recorder.close()
            recorder.path.unlink(missing_ok=True)
            raise
        return recorder

    # -- what it is told -----------------------------------------------------------------------------

    @property
    def safety(self) -> Safety:
        """The gate between every motion and the arm. All of these raise `LocalError` where commands cannot be sent."""
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

    def set_payload(
        self, mass: float, cog: Sequence[float] | None = None, inertia: Sequence[float] | None = None
    ) -> None:
        """Tell what the arm carries; motion goes on.

        Args:
            mass: kg; no more than a quarter above what the arm carries by its data sheet.
            cog: centre of gravity in the flange's frame, (3,), m, each within 1 m; not on CB2.
            inertia: about it: xx, yy, zz, xy, xz, yz, kg m²; from 5.10 on.

        Raises:
            BadValue: a number out of range, or what this firmware cannot be told; nothing was sent.
            NotRunning: the robot does not run, or nothing is known of it; nothing was sent.
        """
        statement = commands.payload(self.firmware, mass, cog, inertia)
        arm = None if self.model is None else MODELS.get(self.model)
        if arm is not None and mass > arm.payload * _PAYLOAD_MARGIN:
            raise BadValue(f"payload mass is {mass:g} kg; a {arm.name} carries {arm.payload:g} kg")
        self._command(statement)

    def set_tcp(self, pose: Sequence[float]) -> None:
        """Put the tool centre point at a pose in the flange's frame: m, and rotation vector in rad.

        Raises:
            BadValue, NotRunning: as `set_payload`.
        """
        self._command(commands.tcp(pose))

    def set_speed_slider(self, fraction: float) -> None:
        """Move the speed slider, 0 to 1.

        Raises:
            BadValue, NotRunning: as `set_payload`.
        """
        self._commanded().outlet.command(commands.speed_slider(fraction))

    def popup(self, text: str, title: str = "Popup", *, warning: bool = False, error: bool = False) -> None:
        """Show a text on the pendant; nothing waits for its being read.

        Raises:
            BadValue, NotRunning: as `set_payload`. A text can hold no quotes, backslashes or line breaks.
        """
        self._command(commands.popup(text, title, warning, error))

    def _command(self, statement: str) -> None:
        self._commanded().outlet.command(commands.secondary(statement))

    def _commanded(self) -> Control:
        if self.control is None:
            raise LocalError(self._refusal)
        return self.control

    # -- its end -------------------------------------------------------------------------------------

    def close(self, timeout: float = 2.0) -> None:
        """End motions, close every stream, and the simulator if there is one; in `timeout` seconds. Idempotent."""
        until = time.monotonic() + timeout
        if self.control is not None:
            self.control.close(timeout)
        with self._lock:
            streams = list(self._streams.values())
        for stream in streams:
            stream.close(max(until - time.monotonic(), 0.0))
        if self.controller is not None:
            self.controller.close()

    def __enter__(self) -> Robot:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"<Robot {self.address} {self._identity.model} firmware {self._identity.firmware}>"

    def _known(self) -> Identity:
        if self._is_stale:
            self._identity = self._source.ask()
            self._is_stale = False
        return self._identity

    def _stream(self, name: str) -> Stream[Any]:
        with self._lock:
            if name not in self._streams:
                robot = weakref.ref(self)  # the stream's thread must not keep a robot that nobody holds any more

                def reconnected() -> None:
                    owner = robot()
                    if owner is not None:
                        owner._is_stale = True

                self._streams[name] = self._source.stream(name, f"{self.address} {name}", reconnected)
            return self._streams[name]

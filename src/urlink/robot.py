"""`connect()` and `Robot`: what the user holds."""

from __future__ import annotations

import itertools
import os
import threading
import time
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

from linkcore.backoff import Backoff
from linkcore.errors import BadRecording, BadValue, ConnectFailed
from linkcore.packet import State
from linkcore.recorder import Recorder
from linkcore.recording import Recording
from linkcore.replay import ReplayClock, ReplayTransport
from linkcore.session import Session
from linkcore.stream import Stream
from linkcore.transport import TcpTransport, Transport

from .address import RecordingAddress, RobotAddress, SimulatorAddress, parse_address
from .decode import INTERFACES
from .firmware import Firmware
from .identity import Identity, identify
from .protocols.primary import PrimaryProtocol
from .protocols.realtime import RealtimeProtocol
from .schemas.realtime import RealtimeState
from .schemas.robot_state import RobotState

if TYPE_CHECKING:
    from .simulator import Controller

__all__ = ["Robot", "connect"]


def connect(
    address: str,
    *,
    timeout: float = 5.0,
    read_only: bool = False,
    backoff: Backoff | None = None,
    silence: float = 2.0,
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

    Raises:
        BadAddress: nobody can read the address.
        BadRecording: the recording does not exist, or is none.
        BadValue: a time that is not positive, or a simulated arm that does not run the firmware.
        UnknownModel: no such arm to simulate.
        ConnectFailed, ConnectionLost, LinkTimeout, WrongPeer: nobody, or somebody else, is there.
    """
    if not timeout > 0 or not silence > 0:
        raise BadValue(f"timeout={timeout}, silence={silence}; expected positive numbers of seconds")
    place = parse_address(address)
    if isinstance(place, RecordingAddress):
        return _replayed(address, place)
    controller = None
    if isinstance(place, SimulatorAddress):
        from .simulator import Controller

        controller = Controller(model=place.model, firmware=place.firmware)
        controller.start()
        place = RobotAddress(controller.host, dict(controller.ports))
    try:
        return _connected(address, place, controller, timeout, read_only, backoff, silence)
    except BaseException:
        if controller is not None:
            controller.close()
        raise


def _connected(
    address: str,
    place: RobotAddress,
    controller: Controller | None,
    timeout: float,
    read_only: bool,
    backoff: Backoff | None,
    silence: float,
) -> Robot:
    suffix = "_readonly" if read_only else ""

    def ask() -> Identity:
        try:
            return identify(place.host, place.ports["primary" + suffix], timeout)
        except ConnectFailed:
            # The version message is on the secondary interface too.
            return identify(place.host, place.ports["secondary" + suffix], timeout)

    def transport(interface: str) -> Transport:
        if interface not in INTERFACES:
            raise BadValue(f"no interface {interface!r}; expected one of {', '.join(INTERFACES)}")
        return TcpTransport(place.host, place.ports[interface + suffix], silence=silence)

    return Robot(
        address,
        ask,
        transport,
        {"backoff": backoff, "timeout": timeout, "silence": silence},
        controller,
    )


def _replayed(address: str, place: RecordingAddress) -> Robot:
    recording = Recording(place.path)
    clock = ReplayClock(recording, place.rate)

    def ask() -> Identity:
        for info in recording.channels.values():
            if "firmware" in info:
                firmware = Firmware.parse(info["firmware"])
                return Identity(firmware, said_so=True, model=info.get("model"))
        raise BadRecording(f"{recording.path} does not say what firmware it was recorded from")

    return Robot(
        address,
        ask,
        lambda interface: ReplayTransport(recording, interface, clock),
        {"backoff": Backoff(first=0, most=0), "silence": None, "lossless": place.rate == 0},
    )


class Robot:
    """A robot: its streams, and what it is. A context manager that closes itself; made by `connect`.

    Attributes:
        address: what it was connected by.
        controller: the simulator behind ``sim://``, or None.
    """

    def __init__(
        self,
        address: str,
        ask: Callable[[], Identity],
        transport: Callable[[str], Transport],
        options: dict[str, Any],
        controller: Controller | None = None,
    ) -> None:
        self.address = address
        self.controller = controller
        self._ask = ask
        self._identity = ask()
        self._is_stale = False
        self._transport = transport
        self._options = options
        self._streams: dict[str, Stream[Any]] = {}
        self._lock = threading.Lock()

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

    def close(self, timeout: float = 2.0) -> None:
        """Close every stream, and the simulator if there is one; within `timeout` seconds. Idempotent."""
        until = time.monotonic() + timeout
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
            self._identity = self._ask()
            self._is_stale = False
        return self._identity

    def _stream(self, name: str) -> Stream[Any]:
        with self._lock:
            if name not in self._streams:
                self._streams[name] = self._make_stream(name)
            return self._streams[name]

    def _make_stream(self, name: str) -> Stream[Any]:
        label = f"{self.address} {name}"
        transport = self._transport(name)
        connections = itertools.count()

        def session() -> Session:
            if next(connections):
                self._is_stale = True
            return RealtimeProtocol() if name == "realtime" else PrimaryProtocol()

        if name == "realtime":
            return Stream(label, transport, session, RealtimeState, **self._options)
        return Stream(label, transport, session, RobotState, parts=_parts, **self._options)


def _parts(packet: State) -> Sequence[State]:
    """The sub-packages of a robot state; other packages have none."""
    return packet.packages if isinstance(packet, RobotState) else ()

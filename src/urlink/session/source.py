"""Sources of a robot's bytes: a controller on the network, or a recording."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

from linkcore.errors import BadRecording, BadValue, ConnectFailed, unraised
from linkcore.net.transport import TcpTransport, Transport
from linkcore.streaming.connection import Connection
from linkcore.streaming.connection_life import Backoff
from linkcore.streaming.fanout import FanOut
from linkcore.streaming.stream import Stream
from linkcore.wire.framing import PacketProtocol
from linkcore.wire.packet import State

from ..protocol.ports import INTERFACES, refusal_hint
from ..protocol.primary.protocol import PrimaryProtocol
from ..protocol.primary.robot_message import OtherPackage, RobotMessage
from ..protocol.primary.robot_state import RobotState, SubPackage
from ..protocol.realtime.packets import RealtimeState
from ..protocol.realtime.protocol import RealtimeProtocol
from .address import RecordingAddress, RobotAddress
from .connect_options import ConnectOptions
from .identity import Identity, described_identity, identify

if TYPE_CHECKING:
    from ..protocol.rtde.protocol import Requests
    from ..protocol.rtde.transport import RtdeTransport


class Source(NamedTuple):
    """The parts of a robot's streams.

    Attributes:
        ask: asks the controller for its identity.
        transport: makes the transport of an interface.
        backoff: how streams connect again; None for the usual.
        timeout: seconds for a connection to be made.
        silence: seconds without a packet after which a connection counts as lost; None for ever.
        is_lossless: a consumer that names no policy makes the source wait.
        channel: the description of an interface's channel in a recording; None where nothing was recorded.
        connection: makes what keeps a connection up, with the arguments of `Connection`.
        rtde: makes the transport of a connection on RTDE; None for the usual.
    """

    ask: Callable[[], Identity]
    transport: Callable[[str], Transport]
    backoff: Backoff | None
    timeout: float
    silence: float | None
    is_lossless: bool
    channel: Callable[[str], Mapping[str, Any]] | None = None
    connection: Callable[..., Connection] = Connection
    rtde: Callable[[Any, Requests], RtdeTransport] | None = None

    def stream(self, interface: str, name: str, reconnected: Callable[[], object]) -> Stream[Any]:
        """A stream of one interface. Nothing connects before it is used.

        Args:
            interface: "realtime", "primary" or "secondary".
            name: for messages.
            reconnected: called in the reader thread after each connection but the first.

        Raises:
            BadValue: no such interface.
            BadRecording: the recording does not hold it.
        """
        numbers = itertools.count()
        is_realtime = interface == "realtime"
        transport = self.transport(interface)

        def protocol() -> PacketProtocol:
            if next(numbers):
                reconnected()
            return RealtimeProtocol() if is_realtime else PrimaryProtocol()

        kind: type[State] = RealtimeState if is_realtime else RobotState
        if is_realtime:
            fan_out = FanOut(kind, ahead=getattr(transport, "newest", None))
        else:
            fan_out = FanOut(kind, parts=_parts, others=(SubPackage, RobotMessage, OtherPackage))
        connection = self.connection(
            name, transport, protocol, fan_out, backoff=self.backoff, timeout=self.timeout, silence=self.silence
        )
        return Stream(connection, kind, lossless=self.is_lossless)


def _parts(packet: State) -> Sequence[State]:
    """The sub-packages of a robot state; other packages have none."""
    return packet.packages if isinstance(packet, RobotState) else ()


def networked(
    place: RobotAddress,
    options: ConnectOptions,
    *,
    tcp: type[TcpTransport] = TcpTransport,
    known: Identity | None = None,
) -> Source:
    """A controller on the network, or a simulated one.

    Args:
        tcp: what its bytes come by.
        known: its identity, if it is known already.
    """
    suffix, timeout, silence = "_readonly" if options.read_only else "", options.timeout, options.silence
    last: list[Identity] = [] if known is None else [known]

    def ask() -> Identity:
        try:
            last[:] = [identify(place.host, place.ports["primary" + suffix], timeout)]
        except ConnectFailed as error:
            first = unraised(error)
        else:
            return last[0]
        try:
            # The version message is on the secondary interface too.
            last[:] = [identify(place.host, place.ports["secondary" + suffix], timeout)]
        except ConnectFailed:
            raise first from None
        finally:
            del first  # it refers to this frame
        return last[0]

    def transport(interface: str) -> Transport:
        if interface != "rtde" and interface not in INTERFACES:
            raise BadValue(f"no interface {interface!r}; expected one of {', '.join(INTERFACES)}")
        # RTDE has no read-only twin: a client without inputs writes nothing.
        host, port = place.host, place.ports["rtde" if interface == "rtde" else interface + suffix]
        if options.isolate and interface == "realtime":
            from linkcore.net.isolated_transport import IsolatedTransport

            boundary = "urlink.protocol.realtime.protocol:RealtimeBoundary"
            decode = RealtimeProtocol().decode
            return IsolatedTransport(host, port, silence=silence, boundary=boundary, decode=decode)
        return tcp(host, port, silence=silence, refused=lambda: refusal_hint(last[0].firmware if last else None))

    return Source(ask, transport, options.backoff, timeout, silence, is_lossless=False)


def recorded(place: RecordingAddress) -> Source:
    """A recording, which is played as it is read.

    Raises:
        BadRecording: it does not exist, or is not a recording.
    """
    # Imported here: a connection to a controller costs less without them.
    from linkcore.recording.file import RecordingFile
    from linkcore.recording.player import ReplayTimeline, ReplayTransport

    recording = RecordingFile(place.path)
    timeline = ReplayTimeline(recording, place.rate)

    def ask() -> Identity:
        for info in recording.channels.values():
            if "firmware" in info:
                return described_identity(info)
        raise BadRecording(f"{recording.path} does not say what firmware it was recorded from")

    def transport(interface: str) -> Transport:
        return ReplayTransport(recording, interface, timeline)

    def channel(interface: str) -> Mapping[str, Any]:
        return recording.channels[recording.channel(interface)]

    at_once = Backoff(first=0, most=0)
    return Source(ask, transport, at_once, timeout=5.0, silence=None, is_lossless=place.rate == 0, channel=channel)

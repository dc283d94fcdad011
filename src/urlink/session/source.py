"""Sources of a robot's bytes: a controller on the network, or a recording."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

from linkcore.errors import BadRecording, BadValue, ConnectFailed, unraised
from linkcore.net.transport import TcpTransport, Transport
from linkcore.streaming.connection import Connection
from linkcore.streaming.connection_life import Backoff
from linkcore.streaming.fanout import FanOut
from linkcore.streaming.flight_record import FlightRecord, SentRecord
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
from .identity import Identity, described_frequency, described_identity, identify

if TYPE_CHECKING:
    from ..protocol.rtde.protocol import Requests
    from ..protocol.rtde.transport import RtdeTransport


class Source(NamedTuple):
    """Source of a robot's streams, with their settings.

    Attributes:
        ask: Function that reads the identity of the controller.
        transport: Function that makes the transport of an interface.
        backoff: Waiting times between attempts to reconnect; None for the default.
        timeout: Maximum time to make a connection, in seconds.
        silence: Maximum time without a packet, in seconds; then the connection counts as lost. None for no limit.
        is_lossless: Whether the source waits for a consumer without a policy, instead of dropping packets.
        channel: Function that returns the description of a recorded interface; None if this is not a recording.
        connection: Class or function that makes a `Connection`, with the same arguments.
        rtde: Function that makes the transport of an RTDE connection; None for the default.
        sent: Record of the bytes that were sent to the robot; None for a recording.
        frequency: Cycles per second of a simulated controller, if its address or its recording states them; None if
            they follow from its firmware.
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
    sent: SentRecord | None = None
    frequency: int | None = None

    def flight(self, interface: str) -> FlightRecord | None:
        """Return a new flight record for a connection to one interface; None if this is a recording."""
        return FlightRecord(*_FLIGHT[interface]) if self.channel is None else None

    def stream(self, interface: str, name: str, reconnected: Callable[[], object]) -> Stream[Any]:
        """Return a stream of one interface. The stream connects when it is first used.

        Args:
            interface: Interface name: "realtime", "primary" or "secondary".
            name: Name of the stream, used in messages.
            reconnected: Function that is called in the reader thread after each connection except the first.

        Raises:
            BadValue: If the interface does not exist.
            BadRecording: If the recording does not contain the interface.
        """
        numbers = itertools.count()
        is_realtime = interface == "realtime"
        transport = self.transport(interface)

        def protocol() -> PacketProtocol:
            if next(numbers):
                reconnected()
            return RealtimeProtocol(self.frequency) if is_realtime else PrimaryProtocol()

        kind: type[State] = RealtimeState if is_realtime else RobotState
        if is_realtime:
            fan_out = FanOut(kind, ahead=getattr(transport, "newest", None))
        else:
            fan_out = FanOut(kind, parts=_parts, others=(SubPackage, RobotMessage, OtherPackage))
        connection = self.connection(
            name,
            transport,
            protocol,
            fan_out,
            backoff=self.backoff,
            timeout=self.timeout,
            silence=self.silence,
            flight=self.flight(interface),
        )
        return Stream(connection, kind, lossless=self.is_lossless)


#: Maximum number of chunks in the flight record of each interface, and its maximum memory in bytes. Ten seconds of
#: real-time packets at 500 Hz need 6.3 MB.
_FLIGHT = {
    "realtime": (5_000, 7_000_000),
    "primary": (500, 1_000_000),
    "secondary": (200, 300_000),
    "rtde": (5_000, 4_000_000),
}

#: Maximum memory of the record of sent bytes, in bytes. 10 s of set-points at 500 Hz need 1.3 MB.
_SENT_MEMORY = 1_500_000


def _parts(packet: State) -> Sequence[State]:
    """Return the sub-packages of a robot state; other packages have none."""
    return packet.packages if isinstance(packet, RobotState) else ()


def networked(
    place: RobotAddress,
    options: ConnectOptions,
    *,
    tcp: type[TcpTransport] = TcpTransport,
    known: Identity | None = None,
) -> Source:
    """Return the source for a controller on the network, or for a simulated controller.

    Args:
        tcp: Class of the transports.
        known: Identity of the controller, if it is known already.
    """
    suffix, timeout, silence = "_readonly" if options.read_only else "", options.timeout, options.silence
    last: list[Identity] = [] if known is None else [known]

    def ask() -> Identity:
        try:
            last[:] = [identify(place.host, place.ports["primary" + suffix], timeout, place.frequency)]
        except ConnectFailed as error:
            first = unraised(error)
        else:
            return last[0]
        try:
            # The secondary interface sends the version message too.
            last[:] = [identify(place.host, place.ports["secondary" + suffix], timeout, place.frequency)]
        except ConnectFailed:
            raise first from None
        finally:
            del first  # breaks the reference cycle between the error and this frame
        return last[0]

    def transport(interface: str) -> Transport:
        if interface != "rtde" and interface not in INTERFACES:
            raise BadValue(f"unknown interface {interface!r}; expected one of {', '.join(INTERFACES)}")
        # RTDE has no read-only port, but a client without inputs writes nothing.
        host, port = place.host, place.ports["rtde" if interface == "rtde" else interface + suffix]
        if options.isolate and interface == "realtime":
            from linkcore.net.isolated_transport import IsolatedTransport

            boundary = "urlink.protocol.realtime.protocol:RealtimeBoundary"
            decode = RealtimeProtocol().decode
            return IsolatedTransport(host, port, silence=silence, boundary=boundary, decode=decode)
        made = tcp(host, port, silence=silence, refused=lambda: refusal_hint(last[0].firmware if last else None))
        made.sent = partial(sent.keep, interface)
        return made

    sent = SentRecord(_SENT_MEMORY)
    return Source(
        ask, transport, options.backoff, timeout, silence, is_lossless=False, sent=sent, frequency=place.frequency
    )


def recorded(place: RecordingAddress) -> Source:
    """Return the source for a recording, which is played while it is read.

    Raises:
        BadRecording: If the recording does not exist, or the file is not a recording.
    """
    # Imported here, to save the import time for connections to a controller.
    from linkcore.recording.file import RecordingFile
    from linkcore.recording.player import ReplayTimeline, ReplayTransport

    recording = RecordingFile(place.path)
    timeline = ReplayTimeline(recording, place.rate)

    def ask() -> Identity:
        for info in recording.channels.values():
            if "firmware" in info:
                return described_identity(info)
        raise BadRecording(f"{recording.path} does not name the firmware of the controller")

    def transport(interface: str) -> Transport:
        return ReplayTransport(recording, interface, timeline)

    def channel(interface: str) -> Mapping[str, Any]:
        return recording.channels[recording.channel(interface)]

    at_once, is_lossless = Backoff(first=0, most=0), place.rate == 0
    frequency = next(filter(None, map(described_frequency, recording.channels.values())), None)
    return Source(ask, transport, at_once, 5.0, None, is_lossless, channel=channel, frequency=frequency)

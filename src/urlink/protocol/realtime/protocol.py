"""Protocol of the real-time interface (ports 30003, 30013), sans-IO: frame boundaries, and bytes to `RealtimeState`.

Only its size identifies a packet. The size is 4 + 8k bytes, and constant during a connection. This is enough to find a
lost boundary again, and to skip packages of the secondary interface (560 and 9 bytes) that the CB2 simulator leaks into
the stream (docs/protocols/realtime.md, sections Framing and Peculiarities).
"""

from __future__ import annotations

import logging
import re
import struct
import weakref
from collections.abc import Callable

from linkcore.clock import Stamp
from linkcore.wire.cycles import MissedCycles
from linkcore.wire.deferred_packet import DeferredPacket
from linkcore.wire.framing import Framer

from ..firmware import RELEASES
from ..headers import REALTIME_INTERFACE, REALTIME_SIZES, ROBOT_STATE, interface_of
from .packets import RealtimeState

_log = logging.getLogger(__name__)

# Two zero bytes, then a size of 4 + 8k below 4096.
_SIZE = re.compile(
    rb"\x00\x00[\x01-\x0f][\x04\x0c\x14\x1c\x24\x2c\x34\x3c\x44\x4c\x54\x5c\x64\x6c\x74\x7c"
    rb"\x84\x8c\x94\x9c\xa4\xac\xb4\xbc\xc4\xcc\xd4\xdc\xe4\xec\xf4\xfc]",
    re.DOTALL,
)
_SIZE_BYTES = 4
_HEAD = struct.Struct(">id")  # size and time
_TIME = struct.Struct(">4xd")  # the time, which follows the size

# Maximum progress of the controller's clock, in seconds, while the boundary was lost and between two packets.
_LONGEST_LOSS = 1.0


class RealtimeBoundary:
    """Frame boundaries of the real-time stream. It learns the size of the packets of the connection.

    Args:
        learnt: Function that is called with the size when it is new or changes.

    While a lost boundary is searched, the size alone does not prove a packet, because in integer coding the digital
    bits can have the same bytes as a size, in every packet. A position is accepted in two cases: it has the size of the
    connection and a time that continues the last time, or a packet of the same size with a later time follows it.
    """

    largest = REALTIME_SIZES.stop - 1 + _HEAD.size
    pace = 256

    def __init__(self, learnt: Callable[[int], object] | None = None) -> None:
        self._learnt = learnt
        self.size = 0
        self.head = b""
        # Unpacked only when a lost boundary is searched.
        self.last: bytes | bytearray = b""
        #: Number of bytes from the position of the last search without a header that continues the time.
        self._judged = 0

    def __str__(self) -> str:
        return REALTIME_INTERFACE

    def whole(self, buffer: bytes | bytearray) -> list[bytes]:
        """Check only the header of each packet, because all packets have one size while the boundary is known."""
        size = self.size
        if not self.last:
            return []
        count = len(buffer) // size
        end = count * size
        for offset, byte in enumerate(self.head):
            if not count or buffer[offset:end:size].count(byte) != count:
                return []
        # One call of C code instead of a slice for each packet.
        frames = list(struct.unpack(f"{size}s" * count, buffer[:end]))
        self.last = frames[-1]
        return frames

    def declared(self, buffer: bytes | bytearray, at: int) -> tuple[int, int]:
        """Check the size as `check` does, without the bytes after it."""
        if len(buffer) - at <= _SIZE_BYTES:  # one byte more than the size is needed to recognise another interface
            return 0, _SIZE_BYTES + 1
        size = int.from_bytes(buffer[at : at + _SIZE_BYTES], "big")
        is_believed = size == self.size if self.size else size in REALTIME_SIZES and size % 8 == 4
        return (size, size) if is_believed else (0, 0)

    def check(self, buffer: bytes | bytearray, at: int) -> tuple[int, int]:
        """See `FrameBoundary.check`."""
        size, need = self.declared(buffer, at)
        there = len(buffer) - at
        if size and not self.last and buffer[at + 4] == ROBOT_STATE:
            # A robot state of 716 bytes has a valid size, but as a real-time packet its time would be 1e-230 s.
            if there < _HEAD.size:
                return 0, _HEAD.size
            if int.from_bytes(buffer[at + 5 : at + 9], "big") <= size - 5:
                return 0, 0
        if size and there >= need:
            self._take(buffer, at, size)
        return size, need

    def search(self, buffer: bytes | bytearray, start: int) -> tuple[int, int, int]:
        """See `FrameBoundary.search`. A packet that continues the time is preferred to a candidate that contains it."""
        end = len(buffer)
        timely = self._find_timely(buffer, start + self._judged)
        self._judged = 0
        last = end if timely is None else timely
        for match in _SIZE.finditer(buffer, start, last):
            at = match.start()
            if end - at < _HEAD.size:
                return at, 0, _HEAD.size
            size, time = _HEAD.unpack_from(buffer, at)
            if size not in REALTIME_SIZES or (timely is not None and at + size >= timely):
                continue
            need = size + _HEAD.size
            if end - at < need:
                # Before then, a packet that continues the time might arrive from the first unchecked position.
                self._judged = end - _HEAD.size + 1 - at
                return at, 0, min(need, self._judged + self.size) if self.last else need
            next_size, later = _HEAD.unpack_from(buffer, at + size)
            if next_size == size and time < later <= time + _LONGEST_LOSS:
                self._take(buffer, at, size)
                return at, size, need
        if timely is None:
            # The last bytes might be the beginning of a header.
            return max(start, end - _SIZE_BYTES + 1), 0, _SIZE_BYTES
        if end - timely >= self.size:
            self._take(buffer, timely, self.size)
        return timely, self.size, self.size

    def _find_timely(self, buffer: bytes | bytearray, start: int) -> int | None:
        """Return the position of the first packet that has the size of the connection and continues the time."""
        if not self.last:
            return None
        (latest,) = _TIME.unpack_from(self.last)
        until = max(len(buffer) - _TIME.size + _SIZE_BYTES, 0)  # end of the size, which the time follows
        at = buffer.find(self.head, start, until)
        while at >= 0:
            (time,) = _TIME.unpack_from(buffer, at)
            if latest <= time <= latest + _LONGEST_LOSS:
                return at
            at = buffer.find(self.head, at + 1, until)
        return None

    def peer(self, buffer: bytes | bytearray) -> str | None:
        """See `FrameBoundary.peer`."""
        other = interface_of(buffer)
        return None if other == REALTIME_INTERFACE else other

    def _take(self, buffer: bytes | bytearray, at: int, size: int) -> None:
        self.last = buffer[at : at + _HEAD.size]
        if size != self.size:
            self.size, self.head = size, size.to_bytes(_SIZE_BYTES, "big")
            if self._learnt is not None:
                self._learnt(size)


class RealtimeProtocol:
    """Decoder of the bytes of one connection to typed states. Each connection needs a new object.

    Args:
        rate: Packets per second of a simulated controller, in Hz; None if they follow from the size of the packets.
    """

    #: ``decode(frame, stamp=None) -> RealtimeState``; raises `PacketError` if the packet is shorter than every layout
    decode: Callable[..., RealtimeState]

    def __init__(self, rate: int | None = None) -> None:
        self._rate = rate
        this = weakref.ref(self)  # weak, because the protocol holds the boundary

        def learn(size: int) -> None:
            protocol = this()
            if protocol is not None:
                protocol._learn(size)

        self._boundary = RealtimeBoundary(learn)
        self.framer = Framer(self._boundary)
        self.cycles: MissedCycles | None = None  # known after the size
        self.unknown = 0
        self._any = _AnyLayout()
        self.decode = self._any.decode

    def take_deferred(self, packet: DeferredPacket, stamp: Stamp) -> RealtimeState | None:
        """Return the state in a packet whose bytes are not made yet; None if its bytes are needed to find its state.

        The bytes are needed until the size of the packets is known, and while the frame boundary is lost.
        """
        boundary, layout = self._boundary, packet.layout
        if layout.size != boundary.size or layout.decode is not self.decode or not self.framer.is_between_packets:
            return None
        boundary.last = packet.head
        state: RealtimeState = packet.state(stamp)
        return state

    @property
    def tails(self) -> int:
        """Number of packets that end in bytes which no known layout explains."""
        return self._any.tails

    def _learn(self, size: int) -> None:
        """Choose the layout for the packet size of this connection."""
        is_first = self.cycles is None
        if is_first:
            periods = periods_of(size) if self._rate is None else (1.0 / self._rate,)
            self.cycles = MissedCycles(_moment, periods, time=_TIME.unpack_from, size=size)
        decode = None
        if all(layout.size != size for layout in RealtimeState.LAYOUTS.all):
            _log.warning(
                "real-time packets of %d bytes: no known firmware sends this size; decoding the known fields", size
            )
        elif is_first:
            decode = RealtimeState.LAYOUTS.decoder(size)
        # The size is unknown or has changed. If it has changed, there might still be packets of both sizes to decode.
        self.decode = decode or self._any.decode


class _AnyLayout:
    """Decoder for packets of any size, which might have a tail.

    It is not a method of the protocol, because this would create a reference cycle until the first packet arrives.

    Attributes:
        tails: Number of packets with a tail.
    """

    def __init__(self) -> None:
        self.tails = 0

    def decode(self, frame: bytes, stamp: Stamp | None = None) -> RealtimeState:
        """Return the state in a packet."""
        state: RealtimeState = RealtimeState.LAYOUTS.decode(frame, None, stamp)
        self.tails += bool(state.tail)
        return state


def periods_of(size: int) -> tuple[float, ...]:
    """Return the possible periods of packets of this size, in s: several if CB3 and e-Series share the size."""
    rates = {release.since.rate for release in RELEASES if release.realtime == size}
    return tuple(1.0 / rate for rate in rates or {RELEASES[-1].since.rate})


def _moment(frame: bytes) -> float:
    time: float = _TIME.unpack_from(frame)[0]
    return time

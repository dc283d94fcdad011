"""The real-time interface (30003, 30013), sans-IO: its frame boundaries, and bytes to `RealtimeState`.

Nothing but the size announces a packet: 4 + 8k bytes, the same for a whole connection. That is enough to find a lost
boundary again, and to skip the secondary-interface packages (560 and 9 bytes) that the CB2 simulator leaks into the
stream (docs/protocols/realtime.md, sections Framing and Peculiarities).
"""

from __future__ import annotations

import logging
import re
import struct
import weakref
from collections.abc import Callable

from linkcore.clock import Stamp
from linkcore.wire.cycles import MissedCycles
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
_TIME = struct.Struct(">4xd")  # the time, without the size before it

# Seconds that the controller's clock may have gone on while the boundary was lost, and between two packets.
_LONGEST_LOSS = 1.0


class RealtimeBoundary:
    """Frame boundaries of the real-time stream. Learns the size of the connection's packets.

    Args:
        learnt: called with the size, each time it is another.

    The size alone is not a proof when looking for a lost boundary: integer-coded digital bits can spell it, in every
    packet anew. A place is believed if it has the connection's size and goes on in time, or if it is followed by a
    packet of the same size and of a later time.
    """

    largest = REALTIME_SIZES.stop - 1 + _HEAD.size
    pace = 256

    def __init__(self, learnt: Callable[[int], object] | None = None) -> None:
        self._learnt = learnt
        self.size = 0
        self.head = b""
        # Unpacked when a lost boundary has to be found.
        self.last: bytes | bytearray = b""
        #: bytes from the place of the last search on in which no header goes on in time
        self._judged = 0

    def __str__(self) -> str:
        return REALTIME_INTERFACE

    def whole(self, buffer: bytes | bytearray) -> list[bytes]:
        """In step, packets of one size follow each other: it is enough that each has its header."""
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
        """As `check`, by the size alone, which is believed whatever follows it."""
        if len(buffer) - at <= _SIZE_BYTES:  # one byte more than the size: by it another interface is recognised
            return 0, _SIZE_BYTES + 1
        size = int.from_bytes(buffer[at : at + _SIZE_BYTES], "big")
        is_believed = size == self.size if self.size else size in REALTIME_SIZES and size % 8 == 4
        return (size, size) if is_believed else (0, 0)

    def check(self, buffer: bytes | bytearray, at: int) -> tuple[int, int]:
        """See `FrameBoundary.check`."""
        size, need = self.declared(buffer, at)
        there = len(buffer) - at
        if size and not self.last and buffer[at + 4] == ROBOT_STATE:
            # 716 bytes of robot state have a legal size. As a real-time packet its time would be 1e-230 s.
            if there < _HEAD.size:
                return 0, _HEAD.size
            if int.from_bytes(buffer[at + 5 : at + 9], "big") <= size - 5:
                return 0, 0
        if size and there >= need:
            self._take(buffer, at, size)
        return size, need

    def search(self, buffer: bytes | bytearray, start: int) -> tuple[int, int, int]:
        """See `FrameBoundary.search`. What goes on in time is preferred to what is merely followed and holds it."""
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
                # Until then a packet that goes on in time may come whole, from the first place that is not judged on.
                self._judged = end - _HEAD.size + 1 - at
                return at, 0, min(need, self._judged + self.size) if self.last else need
            next_size, later = _HEAD.unpack_from(buffer, at + size)
            if next_size == size and time < later <= time + _LONGEST_LOSS:
                self._take(buffer, at, size)
                return at, size, need
        if timely is None:
            # A header may begin with the last bytes.
            return max(start, end - _SIZE_BYTES + 1), 0, _SIZE_BYTES
        if end - timely >= self.size:
            self._take(buffer, timely, self.size)
        return timely, self.size, self.size

    def _find_timely(self, buffer: bytes | bytearray, start: int) -> int | None:
        """The first packet of the connection's size whose time follows that of the last one."""
        if not self.last:
            return None
        (latest,) = _TIME.unpack_from(self.last)
        until = max(len(buffer) - _TIME.size + _SIZE_BYTES, 0)  # of the size, which the time follows
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
    """Bytes in, typed states out; a new one for each connection."""

    #: ``decode(frame, stamp=None) -> RealtimeState``; raises `PacketError` if shorter than every layout
    decode: Callable[..., RealtimeState]

    def __init__(self) -> None:
        this = weakref.ref(self)  # which holds the boundary

        def learn(size: int) -> None:
            protocol = this()
            if protocol is not None:
                protocol._learn(size)

        self.framer = Framer(RealtimeBoundary(learn))
        self.cycles: MissedCycles | None = None  # known with the size
        self.unknown = 0
        self._any = _AnyLayout()
        self.decode = self._any.decode

    @property
    def tails(self) -> int:
        """Packets that end in bytes which no known layout explains."""
        return self._any.tails

    def _learn(self, size: int) -> None:
        """The frame boundary has learnt the size of this connection's packets, and the size determines the layout."""
        is_first = self.cycles is None
        if is_first:
            self.cycles = MissedCycles(_moment, periods_of(size), time=_TIME.unpack_from, size=size)
        decode = None
        if all(layout.size != size for layout in RealtimeState.LAYOUTS.all):
            _log.warning("real-time packets of %d bytes: no such firmware is known; decoded as far as one is", size)
        elif is_first:
            decode = RealtimeState.LAYOUTS.decoder(size)
        # An unknown size, or another than before: packets of both may wait to be decoded.
        self.decode = decode or self._any.decode


class _AnyLayout:
    """Packets that go by their own length, and may have a tail. Not a method of the protocol, which would be in a
    reference cycle with it for as long as no packet has come.

    Attributes:
        tails: packets that have one.
    """

    def __init__(self) -> None:
        self.tails = 0

    def decode(self, frame: bytes, stamp: Stamp | None = None) -> RealtimeState:
        """The state in a packet."""
        state: RealtimeState = RealtimeState.LAYOUTS.decode(frame, None, stamp)
        self.tails += bool(state.tail)
        return state


def periods_of(size: int) -> tuple[float, ...]:
    """Seconds between two packets of this size; several, since some sizes are those of CB3 and of e-Series."""
    rates = {release.since.rate for release in RELEASES if release.realtime == size}
    return tuple(1.0 / rate for rate in rates or {RELEASES[-1].since.rate})


def _moment(frame: bytes) -> float:
    time: float = _TIME.unpack_from(frame)[0]
    return time

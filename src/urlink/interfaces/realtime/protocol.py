"""The real-time interface (30003, 30013), sans-IO: bytes to `RealtimeState`.

Nothing but the length announces a packet: 4 + 8k bytes, the same for a whole connection. That is
enough to find a lost border again, and to skip the secondary-interface packages (560 and 9 bytes)
that the CB2 simulator leaks into the stream. Source: reference ur-realtime, sections 1 and 7.
"""

from __future__ import annotations

import logging
import re
import struct
from collections.abc import Callable, Sequence

from linkcore.stamp import Stamp
from linkcore.wire.framing import Framer

from ..headers import DASHBOARD_GREETING, PACKAGE_SIZES, REALTIME_SIZES
from .packets import RealtimeState

__all__ = ["RealtimeBorder", "RealtimeProtocol"]

_log = logging.getLogger(__name__)

# Two zero bytes, then a size of 4 + 8k between 500 and 4096.
_HEADER = re.compile(
    rb"\x00\x00[\x01-\x0f][\x04\x0c\x14\x1c\x24\x2c\x34\x3c\x44\x4c\x54\x5c\x64\x6c\x74\x7c"
    rb"\x84\x8c\x94\x9c\xa4\xac\xb4\xbc\xc4\xcc\xd4\xdc\xe4\xec\xf4\xfc]",
    re.DOTALL,
)
_TIME = struct.Struct(">d")
# Seconds that the controller's clock may have gone on while the border was lost.
_LONGEST_LOSS = 1.0
# Types of the packages that leak into the stream, and of those around them.
_LEAKING = b"\x05\x10\x14"


class RealtimeBorder:
    """Borders of the real-time stream. Learns the size of the connection's packets.

    The size alone is no proof when looking for a lost border: integer-coded digital bits can spell
    it, in every packet anew. What is believed goes on in time, or is followed by the next packet.
    """

    # One byte more than the size: it tells another interface from this one.
    header = 5
    largest = REALTIME_SIZES.stop - 1

    def __init__(self, learnt: Callable[[int], object] | None = None) -> None:
        self.size = 0
        self._head = b""
        self._learnt = learnt
        #: the bytes of the last packet's time; unpacked when a lost border has to be found
        self._time = b""

    def __str__(self) -> str:
        return "the real-time interface"

    def size_at(self, buffer: bytes, at: int) -> int:
        size = int.from_bytes(buffer[at : at + 4], "big")
        if size == self.size:
            return size
        if self.size or not (size in REALTIME_SIZES and size % 8 == 4):
            return 0
        self._learn(size)
        return size

    def _learn(self, size: int) -> None:
        self.size, self._head = size, size.to_bytes(4, "big")
        if self._learnt is not None:
            self._learnt(size)

    def whole(self, buffer: bytes) -> list[bytes]:
        # In step, packets of one size follow each other: it is enough that each has its header.
        size = self.size
        if not self._time:
            return []
        if len(buffer) == size and buffer.startswith(self._head):
            self._time = buffer[4:12]
            return [buffer]
        count = len(buffer) // size
        end = count * size
        for offset, byte in enumerate(self._head):
            if not count or buffer[offset:end:size].count(byte) != count:
                return []
        self._time = buffer[end - size + 4 : end - size + 12]
        return [buffer[at : at + size] for at in range(0, end, size)]

    def is_broken(self, buffer: bytes, at: int, size: int) -> bool:
        # 716 bytes of robot state have a legal size. As a real-time packet its time would be 1e-230 s.
        if not self._time and buffer[at + 4] == 0x10:
            return int.from_bytes(buffer[at + 5 : at + 9], "big") <= size - 5
        self._time = buffer[at + 4 : at + 12]
        return False

    def find(self, buffer: bytes, start: int) -> tuple[int, bool]:
        for match in _HEADER.finditer(buffer, start):
            at = match.start()
            size = int.from_bytes(match[0], "big")
            if size not in REALTIME_SIZES:
                continue
            if self._goes_on(buffer, at):
                return at, True
            end = at + size
            # Better than a place that is followed by a header is one inside it that goes on in time;
            # as far as its time has come when the end can be judged, so that chunks make no difference.
            for inner in _HEADER.finditer(buffer, at + 1, end + 4):
                if self._goes_on(buffer, inner.start()):
                    return inner.start(), True
            if end + 12 > len(buffer):
                return at, False
            if self._is_followed(buffer, at, size):
                if size != self.size:
                    self._learn(size)
                return at, True
        return max(start, len(buffer) - 3), False

    def _is_followed(self, buffer: bytes, at: int, size: int) -> bool:
        """Whether what ends the packet at `at` is another one, or what leaks into the stream."""
        end = at + size
        follows = buffer.startswith(buffer[at : at + 4], end)
        if size == self.size:
            return follows or (buffer[end : end + 2] == b"\x00\x00" and buffer[end + 4] in _LEAKING)
        if not self._time or not follows:
            return follows
        # Packets had another size before: two have to say so, and one has to come after the other.
        (time,), (later,) = _TIME.unpack_from(buffer, at + 4), _TIME.unpack_from(buffer, end + 4)
        return bool(time < later <= time + _LONGEST_LOSS)

    def _goes_on(self, buffer: bytes, at: int) -> bool:
        """Whether the packet at `at` has the connection's size and a time that follows the last one."""
        if not self._time or at + 12 > len(buffer) or int.from_bytes(buffer[at : at + 4], "big") != self.size:
            return False
        (last,) = _TIME.unpack(self._time)
        (time,) = _TIME.unpack_from(buffer, at + 4)
        return bool(last <= time <= last + _LONGEST_LOSS)

    def peer(self, buffer: bytes) -> str | None:
        if DASHBOARD_GREETING.startswith(buffer[: len(DASHBOARD_GREETING)]):
            return "the dashboard server (port 29999)"
        # As a real-time packet, byte 4 would be the top of a time: 0x00 or 0x3f and up.
        if int.from_bytes(buffer[:4], "big") in PACKAGE_SIZES and buffer[4:5] in (b"\x10", b"\x14"):
            return "a primary or secondary interface (port 30001 or 30002)"
        return None


class RealtimeProtocol:
    """Bytes in, typed states out; a new one for each connection."""

    #: ``decode(frame, stamp=None) -> RealtimeState``; raises `PacketError` if shorter than every layout
    decode: Callable[..., RealtimeState]

    def __init__(self) -> None:
        self.framer = Framer(RealtimeBorder(self._learn))
        self.unknown = 0
        self.tails = 0
        self._size: int | None = None
        self.decode = self._decode_any

    def _learn(self, size: int) -> None:
        """The border has learnt the size of this connection's packets, and the size tells the layout."""
        if all(layout.size != size for layout in RealtimeState.LAYOUTS.all):
            _log.warning("real-time packets of %d bytes: no such firmware is known; decoded as far as one is", size)
        elif self._size is None:
            self._size = size
            self.decode = RealtimeState.LAYOUTS.decoder(size) or self._decode_any
            return
        # An unknown size, or another than before: packets of both may wait to be decoded.
        self._size = 0
        self.decode = self._decode_any

    def _decode_any(self, frame: bytes, stamp: Stamp | None = None) -> RealtimeState:
        """The state in a packet that goes by its own length, and may have a tail."""
        state: RealtimeState = RealtimeState.LAYOUTS.decode(frame, None, stamp)
        self.tails += bool(state.tail)
        return state

    def decode_all(self, frames: Sequence[bytes], stamp: Stamp | None = None) -> list[RealtimeState]:
        """The states of many packets; where they are all of the connection's length, faster than singly.

        Raises:
            PacketError: shorter than every layout.
        """
        if not frames or not self._size:
            return [self._decode_any(frame, stamp) for frame in frames]
        return RealtimeState.LAYOUTS.fitting(self._size)[0].decode_all(frames, stamp)

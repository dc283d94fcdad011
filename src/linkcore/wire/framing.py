"""Conversion of a byte stream to frames, with search for lost frame boundaries, without sockets (sans-IO).

Each protocol declares its `FrameBoundary`. The loop, the limits and the counting are the same for every protocol, and
are defined in this module.

The work is linear in the number of received bytes, however they are divided into chunks. This also holds for bytes that
an attacker has chosen. The examined position only moves forward. A boundary examines a limited number of bytes after
it, and returns the number of bytes that it needs to decide.

With the environment variable ``URLINK_STRICT=1``, which is read when this module is imported, decoding is strict: bytes
that no layout describes are errors. Otherwise these bytes are kept and counted. Use strict decoding for tests against
new firmware. Do not use it to operate a robot.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import Any, Protocol

from ..clock import Stamp
from ..errors import PacketError, WrongPeer
from .cycles import MissedCycles


class FrameBoundary(Protocol):
    """Boundaries of the packets of a protocol. All sizes include the header.

    Two rules make resynchronisation linear and independent of the division into chunks:

    - Each call does a limited amount of work, plus an amount proportional to the bytes that `search` skips. It is only
      called for positions that contain a byte.
    - A result depends only on the bytes up to `need`, so more bytes never change it.
    """

    #: Upper limit of every `need`.
    largest: int
    #: Number of further bytes that must arrive before the next search, while the boundary is lost.
    pace: int
    #: Size of every packet of the connection, once it is known; 0 if the size varies.
    size: int
    #: Bytes with which each packet of this size begins.
    head: bytes
    #: Newest packet of this size, or its beginning.
    last: bytes | bytearray

    def whole(self, buffer: bytes | bytearray) -> list[bytes]:
        """Return the packets at the beginning of the buffer that can be found quickly and with certainty.

        Returns:
            Packets, all of the same size.
        """

    def check(self, buffer: bytes | bytearray, at: int) -> tuple[int, int]:
        """Check whether a packet begins at `at`. It is used while the boundary is known.

        Returns:
            ``(size, need)``: The size of the packet, or 0 if no packet begins there. This is only valid if the buffer
            has at least `need` bytes from `at` to its end; with fewer bytes it is undecided.
        """

    def search(self, buffer: bytes | bytearray, start: int) -> tuple[int, int, int]:
        """Search for the first position, `start` or later, where a packet begins or might begin.

        It is used while the boundary is lost.

        Returns:
            ``(place, size, need)``: If the buffer has at least `need` bytes from `place` to its end, a packet of `size`
            bytes begins there; with fewer bytes it is undecided. No packet begins before `place`.
        """

    def peer(self, buffer: bytes | bytearray) -> str | None:
        """Return the kind of an unexpected peer if its first bytes show it; otherwise None."""


class Framer:
    """Framer that divides a byte stream into packets.

    While the boundary is lost, it searches again after `FrameBoundary.pace` more bytes. So a packet that is found might
    be delayed until these bytes have arrived.

    Args:
        boundary: Boundary of the protocol, used only for this stream.
        limit: Number of bytes without a single packet after which the peer is considered to be of another kind. With
            None this never happens, even if `FrameBoundary.peer` recognises another kind.

    Attributes:
        skipped: Number of bytes that were discarded during searches for a frame boundary.
        resyncs: Number of lost frame boundaries that were found again.
    """

    def __init__(self, boundary: FrameBoundary, *, limit: int | None = 1 << 16) -> None:
        self._boundary = boundary
        self._limit = limit
        # Appending to this buffer and removing from its front have an amortised cost: bytes are not copied again for
        # each chunk.
        self._kept = bytearray()
        self._need: int  # number of bytes to collect before a decision is possible; set whenever bytes are kept
        self._is_lost = False
        self._has_framed = False
        self.skipped = 0
        self.resyncs = 0

    @property
    def rest(self) -> bytes:
        """Bytes that belong to no complete packet yet; always fewer than the sum of `largest` and `pace`."""
        return bytes(self._kept)

    @property
    def is_between_packets(self) -> bool:
        """Whether a packet may begin with the next byte, because all earlier bytes were packets or discarded."""
        return not self._kept and not self._is_lost

    def feed(self, data: bytes) -> list[bytes]:
        """Return the packets that `data` completes.

        Raises:
            WrongPeer: If the bytes do not belong to such a stream.
        """
        kept, boundary = self._kept, self._boundary
        if 0 < boundary.size == len(data) and not kept and not self._is_lost and data.startswith(boundary.head):
            # The common case has as few calls as possible, because with cold caches each call takes 2 to 4 us.
            boundary.last = data
            return [data]
        buffer: bytes | bytearray = data
        if kept:
            kept += data
            if len(kept) < self._need:
                return []
            buffer = kept
        end = len(buffer)
        frames = [] if self._is_lost else boundary.whole(buffer)
        if frames and len(frames[0]) == end:  # the buffer is exactly one packet
            if kept:
                kept.clear()
            return frames
        at = self._cut(buffer, len(frames) * len(frames[0]) if frames else 0, frames)
        if buffer is kept:
            del kept[:at]
        else:
            kept += buffer[at:]
        if self._is_lost and not self._has_framed and self._limit is not None and self.skipped > self._limit:
            raise WrongPeer(f"received {self.skipped} bytes without a valid packet; the last bytes are {data[-16:]!r}")
        return frames

    def _cut(self, buffer: bytes | bytearray, at: int, frames: list[bytes]) -> int:
        """Append the packets that begin at `at` or later to `frames`.

        Return the start of the undecided rest.
        """
        boundary, end = self._boundary, len(buffer)
        self._has_framed = self._has_framed or bool(frames)
        while at < end:
            if self._is_lost:
                place, size, need = boundary.search(buffer, at)
                self.skipped += place - at
                at = place
            else:
                size, need = boundary.check(buffer, at)
            if need > end - at:
                # A search takes longer than reading, so while the boundary is lost, it is not repeated for each byte.
                self._need = max(need, end - at + boundary.pace) if self._is_lost else need
                break
            if size:
                self.resyncs += self._is_lost
                self._is_lost = False
                self._has_framed = True
                frames.append(bytes(buffer[at : at + size]))
                at += size
            else:
                # No packet begins here. Its declared size might span valid packets, so search inside it.
                self._lose(buffer)
                at += 1
        return at

    def _lose(self, buffer: bytes | bytearray) -> None:
        if not self._has_framed and not self.skipped and self._limit is not None:
            peer = self._boundary.peer(buffer)
            if peer is not None:
                raise WrongPeer(f"expected {self._boundary}, but this is {peer}: it begins with {bytes(buffer[:16])!r}")
        self._is_lost = True
        self.skipped += 1


class Counting(Protocol):
    """Decoder that counts unknown types and bytes."""

    @property
    def unknown(self) -> int:
        """Number of packets, or parts of packets, whose type has no known layout."""

    @property
    def tails(self) -> int:
        """Number of packets, or parts of packets, that end in bytes which no known layout describes."""

    def decode(self, frame: bytes, stamp: Stamp | None = None) -> Any:
        """Return the typed packet of one frame.

        Raises:
            PacketError: If no layout can hold it. It is not counted in `unknown` or `tails`.
        """


class PacketProtocol(Counting, Protocol):
    """Protocol of one connection, without sockets (sans-IO). A stream makes a new object for each connection."""

    framer: Framer
    #: Counter of the missing cycles; None while the packets have no time of the peer's clock.
    cycles: MissedCycles | None


#: Whether strict decoding was requested.
_STRICT = os.environ.get("URLINK_STRICT", "") not in ("", "0")


def is_strict() -> bool:
    """Whether bytes that no layout describes are errors."""
    return _STRICT


def check_explained(packet: Any, unknown: int, tails: int) -> None:
    """Reject a packet with unknown parts.

    Args:
        packet: Decoded packet.
        unknown: Number of its parts with an unknown type.
        tails: Number of its parts that end in unknown bytes.

    Raises:
        PacketError: If one of the numbers is not 0.
    """
    kind = type(packet).__name__
    if unknown:
        raise PacketError("the packet, or a part of it, has an unknown type (URLINK_STRICT)", packet=kind)
    if tails:
        raise PacketError("the packet, or a part of it, ends in unknown bytes (URLINK_STRICT)", packet=kind)


def strictly(decoder: Counting) -> Callable[..., Any]:
    """Return a function like `decoder.decode` that rejects packets with unknown bytes.

    The function raises `PacketError` if no layout can hold the packet, or if a part of it has an unknown type or ends
    in unknown bytes.
    """

    def decode(frame: bytes, stamp: Stamp | None = None) -> Any:
        unknown, tails = decoder.unknown, decoder.tails
        packet = decoder.decode(frame, stamp)
        check_explained(packet, decoder.unknown - unknown, decoder.tails - tails)
        return packet

    return decode

"""Bytes to frames, sans-IO: a byte stream is cut at its frame boundaries, and a lost boundary is found again.

Each protocol declares its `FrameBoundary`. The loop, the bounds and the counting are the same for every protocol and
stand here.

The work is linear in the bytes that come, however they are cut into chunks, also for bytes that an adversary chose: the
place that is looked at only moves forward, a boundary looks at a bounded number of bytes beyond it, and returns how
many bytes it needs before it can decide.

With the environment variable ``URLINK_STRICT=1``, read when this module is imported, decoding is strict: bytes that no
layout explains are errors, rather than kept and counted. That is for tests against new firmware, not for the operation
of a robot.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import Any, Protocol

from ..clock import Stamp
from ..errors import PacketError, WrongPeer
from .cycles import MissedCycles


class FrameBoundary(Protocol):
    """How the packets of a protocol are delimited. Sizes count the header.

    Two rules make resynchronisation linear and independent of how the bytes are cut into chunks:

    - Each call does a bounded amount of work, plus what is proportional to the bytes that `search` passes over. It is
      asked about places where a byte is.
    - An answer depends on nothing but the bytes up to `need`, so more bytes never change it.
    """

    #: bound of every `need`
    largest: int
    #: out of step, bytes that have to come before it is worth looking again
    pace: int
    #: bytes of each packet of the connection, once it is known; 0 where they vary
    size: int
    #: with which each packet of that size begins
    head: bytes
    #: the newest packet of that size, or its beginning
    last: bytes | bytearray

    def whole(self, buffer: bytes | bytearray) -> list[bytes]:
        """The packets with which the buffer begins, as far as that can be found quickly and for certain.

        Returns:
            the packets, all of the same size.
        """

    def check(self, buffer: bytes | bytearray, at: int) -> tuple[int, int]:
        """In step: whether the packet that has to begin at `at` is one.

        Returns:
            ``(size, need)``: its size, or 0 if no packet begins there. That holds if `need` bytes from `at` on are in
            the buffer; with fewer it is undecided.
        """

    def search(self, buffer: bytes | bytearray, start: int) -> tuple[int, int, int]:
        """Out of step: the first place from `start` on where a packet begins or can still turn out to begin.

        Returns:
            ``(place, size, need)``: if `need` bytes from `place` on are in the buffer, a packet of `size` bytes begins
            there; with fewer it is undecided. Nothing before `place` can be the beginning of a packet.
        """

    def peer(self, buffer: bytes | bytearray) -> str | None:
        """What else than expected seems to be talking, judged by its first bytes, or None."""


class Framer:
    """Cuts a byte stream into packets.

    Args:
        boundary: of the protocol; used for this stream only.
        limit: bytes without a single packet after which the peer counts as something else. None: never, whatever it
            sends, not even if it says so.

    Out of step it looks again after `FrameBoundary.pace` more bytes, so a packet that is found may be held back until
    they have come.

    Attributes:
        skipped: bytes thrown away while looking for a frame boundary.
        resyncs: how often a lost frame boundary was found again.
    """

    def __init__(self, boundary: FrameBoundary, *, limit: int | None = 1 << 16) -> None:
        self._boundary = boundary
        self._limit = limit
        # Appending is amortised, and so is taking from the front: no byte is copied again for each chunk that comes.
        self._kept = bytearray()
        self._need: int  # bytes that have to be kept before anything can change; known whenever some are kept
        self._is_lost = False
        self._has_framed = False
        self.skipped = 0
        self.resyncs = 0

    @property
    def rest(self) -> bytes:
        """The bytes that belong to no packet yet; always fewer than `largest` and `pace` together."""
        return bytes(self._kept)

    @property
    def is_between_packets(self) -> bool:
        """Whether everything so far was whole packets, or was given up, so that one may begin with the next byte."""
        return not self._kept and not self._is_lost

    def feed(self, data: bytes) -> list[bytes]:
        """The packets that `data` completes, each whole.

        Raises:
            WrongPeer: what comes is not such a stream at all.
        """
        kept, boundary = self._kept, self._boundary
        if 0 < boundary.size == len(data) and not kept and not self._is_lost and data.startswith(boundary.head):
            # The common case, in as few calls as can be: with cold caches each takes 2 to 4 us, be it ever so small.
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
        if frames and len(frames[0]) == end:  # one packet at a time
            if kept:
                kept.clear()
            return frames
        at = self._cut(buffer, len(frames) * len(frames[0]) if frames else 0, frames)
        if buffer is kept:
            del kept[:at]
        else:
            kept += buffer[at:]
        if self._is_lost and not self._has_framed and self._limit is not None and self.skipped > self._limit:
            raise WrongPeer(f"{self.skipped} bytes came and no packet among them; they end with {data[-16:]!r}")
        return frames

    def _cut(self, buffer: bytes | bytearray, at: int, frames: list[bytes]) -> int:
        """Append the packets from `at` on to `frames`; where the undecided rest begins."""
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
                # Judging costs more than reading: out of step it is not done anew for each byte.
                self._need = max(need, end - at + boundary.pace) if self._is_lost else need
                break
            if size:
                self.resyncs += self._is_lost
                self._is_lost = False
                self._has_framed = True
                frames.append(bytes(buffer[at : at + size]))
                at += size
            else:
                # No packet begins here. The size that it declares may swallow good packets: look inside it.
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
    """Decodes, and counts what it does not know."""

    @property
    def unknown(self) -> int:
        """Packets, or parts of one, of a type that no layout is known for."""

    @property
    def tails(self) -> int:
        """Packets, or parts of one, that end in bytes which no known layout explains."""

    def decode(self, frame: bytes, stamp: Stamp | None = None) -> Any:
        """The typed packet in one frame.

        Raises:
            PacketError: no layout holds it. It is not counted in `unknown` or `tails`.
        """


class PacketProtocol(Counting, Protocol):
    """The protocol of one connection, sans-IO; a stream makes a new one each time it connects."""

    framer: Framer
    #: counts the cycles that are missing; None as long as the packets have no time of the peer's clock
    cycles: MissedCycles | None


#: Whether it was asked for.
_STRICT = os.environ.get("URLINK_STRICT", "") not in ("", "0")


def is_strict() -> bool:
    """Whether bytes that no layout explains are errors."""
    return _STRICT


def check_explained(packet: Any, unknown: int, tails: int) -> None:
    """Refuse a packet of which so many parts are not known.

    Raises:
        PacketError: there are any.
    """
    kind = type(packet).__name__
    if unknown:
        raise PacketError("it is, or holds, a type that is not known (URLINK_STRICT)", packet=kind)
    if tails:
        raise PacketError("it, or a part of it, ends in bytes that are not known (URLINK_STRICT)", packet=kind)


def strictly(decoder: Counting) -> Callable[..., Any]:
    """What `decoder.decode` does, for packets of which every byte is known.

    Raises, when it is called:
        PacketError: no layout holds the packet, or a part of it is of an unknown type, or ends in unknown bytes.
    """

    def decode(frame: bytes, stamp: Stamp | None = None) -> Any:
        unknown, tails = decoder.unknown, decoder.tails
        packet = decoder.decode(frame, stamp)
        check_explained(packet, decoder.unknown - unknown, decoder.tails - tails)
        return packet

    return decode

"""Bytes to frames, sans-IO: a stream cut at its borders, and a lost border found again.

What a border looks like is a `Border` of the protocol; the loop, the bounds and the counting are
the same for every protocol and stand here.
"""

from __future__ import annotations

from typing import Protocol

from ..errors import WrongPeer

__all__ = ["Border", "Framer"]


class Border(Protocol):
    """How a protocol's packets are told apart. Sizes count the header."""

    #: bytes from which the size can be read
    header: int
    #: the largest packet; bounds what the framer keeps
    largest: int

    def size_at(self, buffer: bytes, at: int) -> int:
        """Size of the packet whose header begins at `at`, or 0 if no packet can begin there."""

    def whole(self, buffer: bytes) -> list[bytes]:
        """The packets with which the buffer begins, as far as that can be told quickly and for certain."""

    def is_broken(self, buffer: bytes, at: int, size: int) -> bool | None:
        """Whether the whole packet at `at` cannot be one, so that its size is not to be trusted.

        None if the header that follows it is needed to tell, and has not come.
        """

    def find(self, buffer: bytes, start: int) -> tuple[int, bool]:
        """First place from `start` on where a packet begins, and whether that is certain.

        An uncertain place needs more bytes to be judged; the length of the buffer less what could be
        the beginning of a header means that there is none.
        """

    def peer(self, buffer: bytes) -> str | None:
        """What else than expected seems to be talking, judged by its first bytes, or None."""


class Framer:
    """Cuts a byte stream into packets.

    Attributes:
        skipped: bytes thrown away while looking for a border.
        resyncs: how often a lost border was found again.
    """

    #: A peer that has sent this much without one packet is something else.
    patience = 1 << 16

    def __init__(self, border: Border) -> None:
        self._border = border
        self._rest = b""
        self._lost = False
        self._any = False
        self.skipped = 0
        self.resyncs = 0

    @property
    def rest(self) -> bytes:
        """The bytes of an unfinished packet; never more than the largest packet and one header."""
        return self._rest

    def feed(self, data: bytes) -> list[bytes]:
        """The packets that `data` completes, each whole.

        Raises:
            WrongPeer: what comes is no such stream at all.
        """
        border = self._border
        buffer = self._rest + data if self._rest else data
        end = len(buffer)
        frames = [] if self._lost else border.whole(buffer)
        if frames and len(frames[0]) == end:  # the common case: one packet at a time
            self._rest = b""
            return frames
        at = sum(map(len, frames))
        while end - at >= border.header:
            if self._lost:
                found, certain = border.find(buffer, at)
                self.skipped += found - at
                at = found
                if not certain:
                    break
                self._lost = False
                self.resyncs += 1
            size = border.size_at(buffer, at)
            if size == 0:
                self._lose(buffer, at)
                at += 1
                continue
            if at + size > end:
                break
            broken = border.is_broken(buffer, at, size)
            if broken is None:
                break
            if broken:
                # Its size may be a lie that swallows good packets: look inside it for the next.
                self._lose(buffer, at)
                at += 1
                continue
            frames.append(buffer[at : at + size])
            self._any = True
            at += size
        self._rest = buffer[at:] if at else buffer
        if self._lost and not self._any and self.skipped > self.patience:
            raise WrongPeer(f"{self.skipped} bytes came and no packet among them; they end with {buffer[-16:]!r}")
        return frames

    def _lose(self, buffer: bytes, at: int) -> None:
        if not self._any and not self.skipped:
            peer = self._border.peer(buffer)
            if peer is not None:
                raise WrongPeer(f"expected {self._border}, but this is {peer}: it begins with {buffer[:16]!r}")
        self._lost = True
        self.skipped += 1

"""How wide a time stamp is: found from where markers, counts and ids stand in a handshake."""

from __future__ import annotations

import struct

from .entries import Layout

__all__ = ["WIDTHS", "Trial"]

#: Words of a time stamp that are known: the canonical two, and those of 64-bit builds of the ordinary sources.
WIDTHS = (2, 4)

_INT = struct.Struct(">i")
#: Bytes of a data package before its entries: type, direction, count.
_HEAD = 6


class Trial:
    """Whether the values of a handshake fit stamps of so many words.

    Attributes:
        width: the words.
        wrong: offset of the first marker, count or id that does not fit, or None.
        size: bytes of the values, with the end.
        is_complete: all have come and fit.
    """

    def __init__(self, width: int, write: Layout, read: Layout) -> None:
        self.width = width
        self.wrong: int | None = None
        self.expected = b""
        self._marks: list[tuple[int, bytes]] = []
        at = 0
        for direction, layout in ((b"w", write), (b"r", read)):
            self._marks.append((at, b"d" + direction + _INT.pack(layout.count)))
            at += _HEAD
            for identity, length in enumerate(layout.sizes):
                self._marks.append((at, _INT.pack(identity)))
                at += 4 * (1 + width + length)
        self._marks.append((at, b"e"))
        self.size = at + 2
        self._next = 0
        self.is_complete = False

    def advance(self, buffer: bytes | bytearray, start: int) -> None:
        end = len(buffer) - start
        marks = self._marks
        while self.wrong is None and self._next < len(marks):
            at, expected = marks[self._next]
            if at + len(expected) > end:
                return
            if buffer[start + at : start + at + len(expected)] != expected:
                self.wrong, self.expected = at, expected
            self._next += 1
        self.is_complete = self.wrong is None and self.size <= end

"""The way through a data package that comes in pieces."""

from __future__ import annotations

import struct

import numpy as np

from .entries import Entries, Layout

__all__ = ["Walk"]

_INT = struct.Struct(">i")
_WIRE = np.dtype(">i4")


class Walk:
    """A data package of which some is still to come: from entry to entry, as far as it is there.

    The entries are first held against those of an earlier package with as many; from the first that
    differs they are found one by one, since where an entry ends is only known from its id.
    """

    __slots__ = ("_guess", "_ids", "at", "count", "layout", "width")

    def __init__(self, layout: Layout, width: int, count: int, guess: Entries | None) -> None:
        self.layout = layout
        self.width = width
        self.count = count
        self.at = 0  # bytes of the entries found, some of which may be still to come
        self._guess = guess
        self._ids: list[int] = []

    def advance(self, buffer: bytes | bytearray, start: int) -> int | None:
        """Find what entries are there; the offset of an id that cannot be, or None."""
        if self._guess is not None:
            self._follow(self._guess, buffer, start)
        ids, at, end = self._ids, start + self.at, len(buffer)
        sizes, head, count, read = self.layout.sizes, 4 * (1 + self.width), self.layout.count, _INT.unpack_from
        try:
            while len(ids) < self.count and at + 4 <= end:
                (identity,) = read(buffer, at)
                if not 0 <= identity < count:
                    return at
                ids.append(identity)
                at += head + 4 * sizes[identity]
        finally:
            self.at = at - start
        return None

    def _follow(self, guess: Entries, buffer: bytes | bytearray, start: int) -> None:
        """Take the entries that are as guessed; forget the guess if one is not."""
        there = (len(buffer) - start) // 4
        known, upto = len(self._ids), int(np.searchsorted(guess.at, there))
        if upto == known:
            return
        words = np.frombuffer(buffer, _WIRE, there, start)[guess.at[known:upto]]
        same = words == guess.ids[known:upto]
        if not same.all():
            upto = known + int(same.argmin())
            self._guess = None
        self._ids += guess.ids[known:upto].tolist()
        if upto:
            self.at = 4 * (int(guess.at[upto - 1]) + 1 + self.width + self.layout.sizes[self._ids[-1]])

    def is_done(self, buffer: bytes | bytearray, start: int) -> bool:
        return len(self._ids) == self.count and start + self.at <= len(buffer)

    def entries(self) -> Entries:
        return self._guess or Entries(self.layout, np.array(self._ids, np.int64), self.width)

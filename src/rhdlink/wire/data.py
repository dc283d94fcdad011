"""Data packages as numpy arrays, and the positions of their words in the tables of variables.

A data package is a sequence of entries: id, time stamp, data. If the same variables arrive in the same order, all their
words have the same positions. So the positions are computed once, as a `Selection`, and every further package is copied
with a few numpy calls, even if its variables have different lengths. For 1000 variables, this takes 20 us; a loop would
take milliseconds.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from .schema import INT, WORD

#: Ids of variables.
Ids = NDArray[np.int64]
#: Values of variables, one after another.
Words = NDArray[np.int32]
#: Time stamps: a row of seconds and microseconds for each variable.
Stamps = NDArray[np.int64]

#: Number type of a word on the wire.
_WIRE = np.dtype(">i4")
_LOW = 0xFFFFFFFF
#: Maximum number of selections that are remembered. Computing a selection takes ten times as long as using it. A robot
#: whose plugins set variables at different rates has a few kinds of recurring packages: this number allows eight of
#: them, and the empty package of either direction. With one more recurring kind, every selection would be computed
#: again each time.
_REMEMBERED = 10

K = TypeVar("K")


def read_only(array: NDArray[Any]) -> NDArray[Any]:
    """Make this array read-only and return it. Other views of its memory are not affected."""
    array.flags.writeable = False
    return array


class TableLayout:
    """Positions of the variables of one table in its flat storage, in the order of their ids.

    Attributes:
        count: Number of variables.
        lengths: Words of each variable.
        offsets: First word of each variable.
        words: Words of all variables together.
        sizes: `lengths` as a list, for loops.
        uniform: Common length of all variables; None if they differ.
    """

    def __init__(self, lengths: Sequence[int]) -> None:
        self.sizes = list(lengths)
        self.count = len(self.sizes)
        self.lengths: Ids = np.array(self.sizes, np.int64)
        self.offsets: Ids = np.cumsum(self.lengths) - self.lengths
        self.words = sum(self.sizes)
        self.uniform = self.sizes[0] if len(set(self.sizes)) == 1 else None


class Selection:
    """Selection of variables of a table, with the positions of their words.

    Each position is given twice: in a data package, and in the flat storage of the table.

    Attributes:
        ids: Ids of the variables, in the order of the package.
        width: Number of 32-bit words of a time stamp, 2 or 4.
        at: Word of the package at which each entry begins.
        size: Number of words of all entries.
        is_ordered: Whether the ids are ascending and unique.
        starts: First word of each variable in the values of the package.
        rows: The variables, as an index of arrays with one element per variable of the table.
        cells: The words of the variables, as an index of the table's flat storage.
    """

    def __init__(self, layout: TableLayout, ids: Ids, width: int) -> None:
        count = len(ids)
        head = 1 + width  # words of an entry before its data: id and stamp
        lengths = layout.lengths[ids]
        sums = np.cumsum(lengths)
        total = int(lengths.sum())
        self.ids = ids
        self._key = ids.tobytes()
        self._expected = ids.astype(np.int32).tobytes()
        self.width = width
        self.starts: Ids = sums - lengths
        self.at: Ids = self.starts + head * np.arange(count)
        self.size = total + head * count
        self.is_ordered = bool((np.diff(ids) > 0).all())
        if count and self.is_ordered and ids[-1] - ids[0] == count - 1:
            # Use a slice if possible, because numpy copies a slice several times as fast as an array of indices.
            first, begin = int(ids[0]), int(layout.offsets[ids[0]])
            self.rows: slice | Ids = slice(first, first + count)
            self.cells: slice | Ids = slice(begin, begin + total)
        else:
            self.rows = ids
            self.cells = np.arange(total) + np.repeat(layout.offsets[ids] - self.starts, lengths)
        # If all lengths are equal, a package is a table with a fixed number of columns. Otherwise list each word's
        # position.
        self._stride = None if layout.uniform is None else head + layout.uniform
        self._valued: Ids | None = None
        self._stamped: Ids | None = None
        if self._stride is None:
            # The data of entry k comes after k + 1 heads and the data of the previous entries.
            self._valued = np.arange(total) + np.repeat(head * np.arange(1, count + 1), lengths)
            self._stamped = (self.at + 1)[:, None] + np.arange(width)

    def selects(self, ids: Ids) -> bool:
        """Whether this selection consists of these variables, in this order."""
        return ids is self.ids or ids.tobytes() == self._key

    # -- reading -------------------------------------------------------------------------------

    def fits(self, words: Words) -> bool:
        """Whether the words of a package belong to these variables.

        This is true if the ids of the variables are at the expected positions.
        """
        return words[self.at].tobytes() == self._expected

    def values(self, words: Words) -> Words:
        """Extract the values from the words of a package."""
        if self._stride is not None:
            return words.reshape(-1, self._stride)[:, 1 + self.width :].reshape(-1)
        return words[self._valued]

    def stamps(self, words: Words) -> Stamps:
        """Extract the time stamps from the words of a package."""
        if self._stride is not None:
            raw = words.reshape(-1, self._stride)[:, 1 : 1 + self.width].astype(np.int64)
        else:
            raw = words[self._stamped].astype(np.int64)
        raw &= _LOW
        if self.width == 2:
            return raw
        # A little-endian 64-bit host sends sec_low, sec_high, usec_low, usec_high (docs/protocols/rhd.md, Time stamps).
        return raw[:, 0::2] | (raw[:, 1::2] << 32)

    # -- writing -------------------------------------------------------------------------------

    def pack(self, values: Words, stamps: Stamps) -> bytes:
        """Encode the entries as bytes, from the flat storage and the stamps of the whole table."""
        own = stamps[self.rows]
        if self.width == 4:
            wide = np.empty((len(self.ids), 4), np.int64)
            wide[:, 0::2] = own & _LOW
            wide[:, 1::2] = own >> 32
            own = wide
        words = np.empty(self.size, np.int32)
        words[self.at] = self.ids
        if self._stride is not None:
            table = words.reshape(-1, self._stride)
            table[:, 1 : 1 + self.width] = own
            table[:, 1 + self.width :] = values[self.cells].reshape(-1, self._stride - 1 - self.width)
        else:
            words[self._stamped] = own
            words[self._valued] = values[self.cells]
        return words.astype(_WIRE).tobytes()


def remember(known: dict[K, Selection], key: K, selection: Selection) -> None:
    """Store a selection as the newest one.

    If `_REMEMBERED` selections are already stored, drop the oldest one.
    """
    known.pop(key, None)  # so that it becomes the newest, because a dict keeps the order of insertion
    if len(known) >= _REMEMBERED:
        del known[next(iter(known))]
    known[key] = selection


class DataPackage:
    """Checked data package with values of variables.

    If the package contains a variable twice, the last value is used.

    Attributes:
        direction: "r" from robot to program, or "w" from program to robot.
        selection: Variables of the package.
        words: Words of all entries, in the machine's own order.
    """

    __slots__ = ("direction", "selection", "words")

    def __init__(self, direction: str, selection: Selection, words: Words) -> None:
        self.direction = direction
        self.selection = selection
        self.words = words

    @classmethod
    def read(cls, direction: str, selection: Selection, buffer: bytes | bytearray, start: int) -> DataPackage:
        """Read the package of these variables whose entries begin at `start`.

        Their ids are not checked.
        """
        return cls(direction, selection, np.frombuffer(buffer, _WIRE, selection.size, start).astype(np.int32))

    def __len__(self) -> int:
        return len(self.selection.ids)

    @property
    def ids(self) -> Ids:
        """Ids of the variables, in the order of the package."""
        return self.selection.ids

    @property
    def values(self) -> Words:
        """Values of the variables, one after another."""
        return self.selection.values(self.words)

    @property
    def stamps(self) -> Stamps:
        """Time stamps of the variables, shape (n, 2): seconds and microseconds."""
        return self.selection.stamps(self.words)


class Cursor:
    """Position in a partly received data package.

    The position moves from entry to entry, as far as the entries have arrived.

    The entries are first compared with an earlier package of the same number of entries. From the first difference,
    entries are found one by one, because only the id of an entry determines its end.

    Attributes:
        layout: Layout of the table.
        width: Number of 32-bit words of a time stamp.
        count: Number of entries of the package.
        at: Number of bytes of the entries found so far. Some of these bytes may not have arrived yet.
    """

    __slots__ = ("_guess", "_ids", "at", "count", "layout", "width")

    def __init__(self, layout: TableLayout, width: int, count: int, guess: Selection | None) -> None:
        self.layout = layout
        self.width = width
        self.count = count
        self.at = 0
        self._guess = guess
        self._ids: list[int] = []

    def advance(self, buffer: bytes | bytearray, start: int) -> int | None:
        """Find the entries that have arrived.

        Return the offset of an id that no variable has; otherwise None.

        Args:
            buffer: Received bytes.
            start: Offset of the first entry in the buffer.
        """
        if self._guess is not None:
            self._compare(self._guess, buffer, start)
        ids, at, end = self._ids, start + self.at, len(buffer)
        sizes, head, count, read = self.layout.sizes, WORD * (1 + self.width), self.layout.count, INT.unpack_from
        while len(ids) < self.count and at + WORD <= end:
            (identity,) = read(buffer, at)
            if not 0 <= identity < count:
                return at
            ids.append(identity)
            at += head + WORD * sizes[identity]
        self.at = at - start
        return None

    def _compare(self, guess: Selection, buffer: bytes | bytearray, start: int) -> None:
        """Accept the entries that match the guess. Drop the guess if one does not match."""
        there = (len(buffer) - start) // WORD
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
            self.at = WORD * (int(guess.at[upto - 1]) + 1 + self.width + self.layout.sizes[self._ids[-1]])

    def is_done(self, buffer: bytes | bytearray, start: int) -> bool:
        """Whether the whole package has arrived."""
        return len(self._ids) == self.count and start + self.at <= len(buffer)

    def selection(self) -> Selection:
        """Variables of the package, after it has arrived."""
        return self._guess or Selection(self.layout, np.array(self._ids, np.int64), self.width)

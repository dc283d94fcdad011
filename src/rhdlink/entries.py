"""Data packages: which words of a package belong to which words of a table.

A package is a row of entries: id, time stamp, data. As long as the same variables come in the same
order, the places of all their words are the same too, so they are worked out once (`Entries`) and every
further package is moved by a few numpy calls, whatever the lengths of its variables.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

__all__ = ["Data", "Entries", "Ids", "Layout", "Stamps", "Words"]

#: Ids of variables.
Ids = NDArray[np.int64]
#: Values of variables, one after another.
Words = NDArray[np.int32]
#: Time stamps: a row of seconds and microseconds for each variable.
Stamps = NDArray[np.int64]

_WIRE = np.dtype(">i4")
_LOW = 0xFFFFFFFF


class Layout:
    """How the variables of one table lie in its flat storage, in the order of their ids.

    Attributes:
        count: variables.
        lengths: words of each variable.
        offsets: first word of each variable.
        words: words of all variables.
        sizes: `lengths` as a list, for loops.
        uniform: the length that all variables have, or None if they differ.
    """

    def __init__(self, lengths: Sequence[int]) -> None:
        self.sizes = list(lengths)
        self.count = len(self.sizes)
        self.lengths: Ids = np.array(self.sizes, np.int64)
        self.offsets: Ids = np.cumsum(self.lengths) - self.lengths
        self.words = sum(self.sizes)
        self.uniform = self.sizes[0] if len(set(self.sizes)) == 1 else None


class Entries:
    """The entries of a data package: the places of their words in the package and in the table.

    Attributes:
        ids: the variables, in the order of the package.
        width: words of a time stamp, 2 or 4.
        at: word of the package at which each entry begins.
        size: words of all entries.
        is_ordered: the ids ascend, and none is there twice.
        starts: first word of each variable among the values of the package.
    """

    __slots__ = (
        "_bytes",
        "_cells",
        "_expected",
        "_inside",
        "_rows",
        "_stamped",
        "_stride",
        "at",
        "ids",
        "is_ordered",
        "size",
        "starts",
        "width",
    )

    def __init__(self, layout: Layout, ids: Ids, width: int) -> None:
        count = len(ids)
        head = 1 + width
        lengths = layout.lengths[ids]
        sums = np.cumsum(lengths)
        total = int(sums[-1]) if count else 0
        self.ids = ids
        self._bytes = ids.tobytes()
        self._expected = ids.astype(np.int32).tobytes()
        self.width = width
        self.starts: Ids = sums - lengths
        self.at: Ids = self.starts + head * np.arange(count)
        self.size = total + head * count
        first = int(ids[0]) if count else 0
        self.is_ordered = count == 0 or bool((np.diff(ids) > 0).all())
        in_row = count == 0 or (self.is_ordered and int(ids[-1]) - first == count - 1)
        self._rows: slice | Ids = slice(first, first + count) if in_row else ids
        # With all lengths equal a package is a table of so many columns, else every word has its own place.
        self._stride = None if layout.uniform is None else head + layout.uniform
        self._inside: Ids | None = None
        self._stamped: Ids | None = None
        if self._stride is None:
            # Entry k has its data behind k + 1 heads, and where the values before it end.
            self._inside = np.arange(total) + np.repeat(head * np.arange(1, count + 1), lengths)
            self._stamped = (self.at + 1)[:, None] + np.arange(width)
        if in_row:
            begin = int(layout.offsets[first]) if count else 0
            self._cells: slice | Ids = slice(begin, begin + total)
        else:
            self._cells = np.arange(total) + np.repeat(layout.offsets[ids] - self.starts, lengths)

    @property
    def rows(self) -> slice | Ids:
        """The variables as an index of arrays with an element for each variable of the table."""
        return self._rows

    @property
    def cells(self) -> slice | Ids:
        """The values as an index of the table's flat storage."""
        return self._cells

    def are(self, ids: Ids) -> bool:
        """Whether they are of these variables, in this order."""
        return ids is self.ids or ids.tobytes() == self._bytes

    # -- reading -------------------------------------------------------------------------------

    def fits(self, words: Words) -> bool:
        """Whether the words of a package are these entries: whether their ids stand where they should."""
        return words[self.at].tobytes() == self._expected

    def values(self, words: Words) -> Words:
        """The values in the words of a package."""
        if self._stride is not None:
            return words.reshape(-1, self._stride)[:, 1 + self.width :].reshape(-1)
        return words[self._inside]

    def stamps(self, words: Words) -> Stamps:
        """The stamps in the words of a package."""
        if self._stride is not None:
            raw = words.reshape(-1, self._stride)[:, 1 : 1 + self.width].astype(np.int64)
        else:
            raw = words[self._stamped].astype(np.int64)
        raw &= _LOW
        if self.width == 2:
            return raw
        # A little-endian 64-bit host sends sec_low, sec_high, usec_low, usec_high (section 2).
        return raw[:, 0::2] | (raw[:, 1::2] << 32)

    # -- writing -------------------------------------------------------------------------------

    def pack(self, values: Words, stamps: Stamps) -> bytes:
        """The entries as bytes, from the flat storage and the stamps of the whole table."""
        own = stamps[self._rows]
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
            table[:, 1 + self.width :] = values[self._cells].reshape(-1, self._stride - 1 - self.width)
        else:
            words[self._stamped] = own
            words[self._inside] = values[self._cells]
        return words.astype(_WIRE).tobytes()


class Data:
    """One data package, checked: values for variables.

    Where a package holds a variable twice, the last counts.

    Attributes:
        direction: "r" from robot to program, or "w" from program to robot.
        entries: which variables.
        words: the words of all entries, in the machine's own order.
    """

    __slots__ = ("direction", "entries", "words")

    def __init__(self, direction: str, entries: Entries, words: Words) -> None:
        self.direction = direction
        self.entries = entries
        self.words = words

    def __len__(self) -> int:
        return len(self.entries.ids)

    @property
    def ids(self) -> Ids:
        """The variables, in the order of the package."""
        return self.entries.ids

    @property
    def values(self) -> Words:
        """Their values, one after another."""
        return self.entries.values(self.words)

    @property
    def stamps(self) -> Stamps:
        """Their time stamps, shape (n, 2): seconds and microseconds."""
        return self.entries.stamps(self.words)

    def items(self) -> Iterator[tuple[int, tuple[int, int], Words]]:
        """Each entry: id, (seconds, microseconds), values."""
        values, entries = self.values, self.entries
        sizes = np.diff(entries.starts, append=len(values))
        for identity, start, size, (seconds, micros) in zip(
            self.ids.tolist(), entries.starts.tolist(), sizes.tolist(), self.stamps.tolist(), strict=True
        ):
            yield identity, (seconds, micros), values[start : start + size]

"""Dirty sets: which variables have changed and are still to be sent, for each peer."""

from __future__ import annotations

import numpy as np

from ..wire.data import Ids, read_only

#: So many ids are sorted in a list; beyond it, looking at the flag of every variable is quicker.
_FEW = 64

#: Read only, as all that is taken from a set: several parties hold the same array.
_NONE = read_only(np.empty(0, np.int64))


class DirtySet:
    """A set of ids, emptied as a whole. Its cost depends on how many are in it, not on how many there are.

    Where the sets of two clients are filled alike, they hand out the same array, so that the package that was encoded
    for one serves the other.
    """

    __slots__ = ("_few", "_flags", "_has_flags", "_marks", "_whole")

    def __init__(self, count: int) -> None:
        self._marks = bytearray(count)
        self._flags = np.frombuffer(self._marks, np.uint8)  # the same memory, for numpy
        self._few: list[int] = []  # added one by one
        self._has_flags = False  # some were added together, and are only in the flags
        self._whole: Ids | None = None  # an array that was added to the empty set, not yet in the flags

    def add(self, identity: int) -> None:
        """Add one."""
        if self._whole is not None:
            self._spread()
        if not self._marks[identity]:
            self._marks[identity] = 1
            self._few.append(identity)

    def add_many(self, ids: Ids, *, ordered: bool = False) -> None:
        """Add many; `ordered` says that they ascend and none is there twice."""
        if not len(ids):
            return
        if ordered and self._whole is None and not self:
            self._whole = ids
            return
        if self._whole is not None:
            if ids is self._whole:
                return
            self._spread()
        if len(ids) <= _FEW:
            for identity in ids.tolist():
                self.add(identity)
            return
        self._flags[ids] = 1
        self._has_flags = True

    def take(self) -> Ids:
        """All that are in it, ascending and read only; it is empty then."""
        if self._whole is not None:
            whole, self._whole = self._whole, None
            return whole
        few = self._few
        if not self._has_flags and len(few) <= _FEW:
            if not few:
                return _NONE
            self._few = []
            for identity in few:
                self._marks[identity] = 0
            few.sort()
            return read_only(np.array(few, np.int64))
        ids = self._flags.nonzero()[0]
        self._flags[ids] = 0
        self._few, self._has_flags = [], False
        return read_only(ids)

    def __bool__(self) -> bool:
        return self._whole is not None or self._has_flags or bool(self._few)

    def _spread(self) -> None:
        whole, self._whole = self._whole, None
        if whole is not None:
            self.add_many(whole)

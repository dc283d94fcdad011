"""Dirty sets. A dirty set contains the variables that have changed and must still be sent to a peer."""

from __future__ import annotations

import numpy as np

from ..wire.data import Ids, read_only

#: Up to this number of ids, a list is sorted. Above it, checking the flag of every variable is faster.
_FEW = 64

#: Read-only, like all arrays that are taken from a set, because several users share the same array.
_NONE = read_only(np.empty(0, np.int64))


class DirtySet:
    """Set of ids that is emptied as a whole.

    Its cost depends on its size, not on the number of variables.

    If the sets of two clients are filled in the same way, they return the same array. So a package that was encoded for
    one client can be sent to the other.
    """

    __slots__ = ("_few", "_flags", "_has_flags", "_marks", "_whole")

    def __init__(self, count: int) -> None:
        self._marks = bytearray(count)
        self._flags = np.frombuffer(self._marks, np.uint8)  # the same memory, for numpy
        self._few: list[int] = []  # ids that were added one by one
        self._has_flags = False  # whether some ids were added together, and are only in the flags
        self._whole: Ids | None = None  # array that was added to the empty set, and is not yet in the flags

    def add(self, identity: int) -> None:
        """Add one id."""
        if self._whole is not None:
            self._spread()
        if not self._marks[identity]:
            self._marks[identity] = 1
            self._few.append(identity)

    def add_many(self, ids: Ids, *, ordered: bool = False) -> None:
        """Add many ids. `ordered` means that they are ascending and unique."""
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
        """Remove and return all ids, in ascending order, as a read-only array."""
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

"""Which variables changed and have not been told of yet; one such set for each who is to be told."""

from __future__ import annotations

import numpy as np

from .entries import Ids

__all__ = ["Pending"]

#: So many are sorted; beyond it, looking at every variable's mark is quicker.
_FEW = 64


def _fixed(ids: Ids) -> Ids:
    """Nobody may change what several hold."""
    ids.flags.writeable = False
    return ids


_NONE = _fixed(np.empty(0, np.int64))


class Pending:
    """A set of ids, emptied as a whole. What it costs depends on how many are in it.

    Where the sets of two takers are filled alike, they hand out the same array, so that what was
    prepared for one serves the other.
    """

    __slots__ = ("_few", "_flags", "_marks", "_mixed", "_whole")

    def __init__(self, count: int) -> None:
        self._marks = bytearray(count)
        self._flags = np.frombuffer(self._marks, np.uint8)
        self._few: list[int] = []  # marked one by one
        self._mixed = False  # some were marked together
        self._whole: Ids | None = None  # all there is, not marked yet

    def add(self, identity: int) -> None:
        """Put one in."""
        if self._whole is not None:
            self._spread()
        if not self._marks[identity]:
            self._marks[identity] = 1
            self._few.append(identity)

    def add_many(self, ids: Ids, *, ordered: bool = False) -> None:
        """Put many in; `ordered` says that they ascend and none is there twice."""
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
        self._mixed = True

    def take(self) -> Ids:
        """All that are in it, ascending and read only; it is empty then."""
        if self._whole is not None:
            whole, self._whole = self._whole, None
            return whole
        few = self._few
        if not self._mixed and len(few) <= _FEW:
            if not few:
                return _NONE
            self._few = []
            for identity in few:
                self._marks[identity] = 0
            few.sort()
            return _fixed(np.array(few, np.int64))
        ids = self._flags.nonzero()[0]
        self._flags[ids] = 0
        self._few, self._mixed = [], False
        return _fixed(ids)

    def __bool__(self) -> bool:
        return self._whole is not None or self._mixed or bool(self._few)

    def _spread(self) -> None:
        whole, self._whole = self._whole, None
        if whole is not None:
            self.add_many(whole)

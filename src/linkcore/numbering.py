"""Numbers that are given once each, for calls, stops, programs and tokens.

`next` of `itertools.count` is one step only while the interpreter has a global lock. Without it, two threads may get
the same number (CPython 3.13, free-threaded build). Then a stop could have the number of a call, or two programs could
have the same name.
"""

from __future__ import annotations

import itertools
import threading

from .process import free_in_child

#: Lock of all numberings. It is re-entrant, because a signal handler may interrupt the holder; `next` of a count is one
#: step for the handler. It belongs to the module, so that threads in simulated time do not yield while they hold it.
_lock = threading.RLock()
free_in_child(_lock)


class Numbering:
    """Ascending whole numbers. Each one is given once, to whichever thread asks first.

    Args:
        first: First number.
    """

    def __init__(self, first: int = 1) -> None:
        self._numbers = itertools.count(first)

    def next(self) -> int:
        """Return the next number, which is larger than all earlier numbers of all threads."""
        with _lock:
            return next(self._numbers)

"""Processor of a simulation, to which its waiting threads are restricted.

Only one thread of a simulation runs at a time. If the next thread wakes up on a different processor, the change takes
several times as long: the processor is often asleep, and its caches do not hold the data of the simulation. So a
waiting thread may only wake up on the processor of the simulation. While a thread runs, it may use all processors.
Therefore processes and native threads that it starts are not restricted, and the system can still move the simulation
away from a busy processor.

Only Linux offers this. On other systems, these functions do nothing.
"""

from __future__ import annotations

import contextlib
import os
import sys

#: Number of waits after which the current processor becomes the processor of the simulation.
_RENEWAL = 64
#: Number of the field of /proc/thread-self/stat that contains the processor, counted from 0 after the name.
_FIELD = 36

#: Processor to which a thread is restricted while it waits, and the processors that it may use otherwise.
Narrowed = tuple[set[int], set[int]]


class Processor:
    """Processor of one simulation."""

    def __init__(self) -> None:
        self._own: set[int] = set()
        #: Waits until `_own` is renewed.
        self._left = 0

    if sys.platform == "linux":

        def narrow(self) -> Narrowed | None:
            """Restrict the current thread, which is about to wait, to the processor of the simulation.

            Return what `widen` needs; None if nothing was changed.
            """
            allowed = os.sched_getaffinity(0)
            if len(allowed) < 2:
                return None
            if self._left == 0:
                self._left, self._own = _RENEWAL, _current()
            self._left -= 1
            if not self._own or not self._own <= allowed:
                return None
            try:
                os.sched_setaffinity(0, self._own)
            except OSError:
                return None
            return self._own, allowed

        def widen(self, narrowed: Narrowed | None) -> None:
            """Let the current thread use all processors that it could use before `narrow`."""
            # Something else might have set its processors during the wait, for example `realtime_options`.
            if narrowed is not None and os.sched_getaffinity(0) == narrowed[0]:
                with contextlib.suppress(OSError):
                    os.sched_setaffinity(0, narrowed[1])

    else:

        def narrow(self) -> Narrowed | None:
            """Do nothing."""
            return None

        def widen(self, narrowed: Narrowed | None) -> None:
            """Do nothing."""


def _current() -> set[int]:
    """Return the processor of the current thread; an empty set if it is unknown."""
    try:
        with open("/proc/thread-self/stat", "rb") as file:
            return {int(file.read().rpartition(b")")[2].split()[_FIELD])}
    except (OSError, IndexError, ValueError):
        return set()

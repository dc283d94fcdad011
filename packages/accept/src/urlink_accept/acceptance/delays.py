"""Delays of this computer during a run, measured so that they are not blamed on the controller."""

from __future__ import annotations

import threading
from collections.abc import Callable

from linkcore import clock
from urlink.tools import started

#: Interval between two wake-ups, and smallest delay that is reported, in s.
_STEP, _LEAST = 0.01, 0.002


class DelayMeter:
    """Context manager with a thread that wakes up every 10 ms, and reports the delay of each wake-up.

    A busy computer delays this thread in the same way as the threads that read and send packets.

    Args:
        report: Function that is called with each delay of 2 ms or more, in s, at the end of the delay.
    """

    def __init__(self, report: Callable[[float], object]) -> None:
        self._report = report
        self._ended = False
        self._thread = threading.Thread(target=self._measure, name="urlink-accept delays", daemon=True)

    def __enter__(self) -> DelayMeter:
        started(self._thread)
        return self

    def __exit__(self, *exc: object) -> None:
        self._ended = True
        self._thread.join()

    def _measure(self) -> None:
        while not self._ended:
            due = clock.now() + _STEP
            clock.sleep(_STEP)
            if (late := clock.now() - due) > _LEAST:
                self._report(late)

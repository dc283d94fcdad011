"""Commands that may be older than their clients wait for them, by the one clock of the process that carries them out.

What is sent to a process that is suspended, or gets no processor time, waits in the buffers of the middleware, and is
delivered when the process goes on. Its client has given it up by then. The middleware does not tell how old a command
is, but whether this process was held up can be measured here, without another clock: something ticks ten times a
second, and where a tick is late, what comes for a while after it may have been sent before it.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable

from urlink import LinkTimeout

__all__ = ["Expiry"]

#: Seconds between two ticks after which what comes may be too old.
_HELD_UP = 2.0
#: Seconds for which commands are refused then: Fast DDS sends again what was lost with its heartbeats, every 3 s.
_SETTLING = 4.0


def _now() -> float:
    """Seconds of a clock that also goes on while the computer sleeps, where the system has one."""
    boot_time = getattr(time, "CLOCK_BOOTTIME", None)
    return time.monotonic() if boot_time is None else time.clock_gettime(boot_time)


class Expiry:
    """Whether this process was held up so lately that a command may have been given up.

    Args:
        now: seconds of the clock.
    """

    def __init__(self, now: Callable[[], float] = _now) -> None:
        self._now = now
        self._lock = threading.Lock()
        self._ticked: float | None = None
        self._held_up = 0.0  # seconds, the last time
        self._until = -math.inf  # commands are refused
        self._is_new = False  # that it was held up, since the last tick

    def tick(self) -> bool:
        """Note that this process runs, ten times a second; whether it was held up since the last tick."""
        with self._lock:
            self._measure()
            was_held_up, self._is_new = self._is_new, False
            return was_held_up

    def check(self) -> None:
        """Refuse a command that may have been sent before this process went on.

        Raises:
            LinkTimeout: it was held up for more than 2 s, not long ago: nothing was done.
        """
        with self._lock:
            if self._ticked is not None:  # before the first there was nothing to be held up
                self._measure()
            left = self._until - self._now()
        if left > 0.0:
            raise LinkTimeout(
                f"this process was held up for {self._held_up:.1f} s, so the command may be as old, and its client may "
                f"have given it up: nothing was done. Commands are taken again in {left:.1f} s"
            )

    def _measure(self) -> None:
        now = self._now()
        gap = 0.0 if self._ticked is None else now - self._ticked
        self._ticked = now
        if gap > _HELD_UP:
            self._held_up, self._until, self._is_new = gap, now + _SETTLING, True

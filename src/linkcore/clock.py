"""The clock: as a value for defaults, the times at which bytes arrived, and whether this process was held up.

Simulated time (`linkcore.simulated`) takes the place of `time.monotonic` in each module that has it by a name. A
default is bound when its function is defined and would stay the real clock, so `monotonic` is a function, which looks
the name up when it is called.

`Expiry` is for a server that offers a robot in a middleware. What is sent to a process that is suspended, or gets no
processor time, waits in the buffers of the middleware, and is delivered when the process goes on. Its client has given
it up by then. The middleware does not tell how old a command is, but whether this process was held up can be measured
here, without another clock: something ticks ten times a second, and where a tick is late, what comes for a while after
it may have been sent before it.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable
from typing import NamedTuple

from .errors import LinkTimeout


def monotonic() -> float:
    """Seconds of `time.monotonic`, of the simulated clock while time is simulated."""
    return time.monotonic()


class Stamp(NamedTuple):
    """When the bytes of a packet arrived, on two clocks.

    Attributes:
        monotonic: `time.monotonic()` in seconds; compare with it to learn an age.
        wall: `time.time()`, seconds since 1970 UTC; compare with it across machines.
    """

    monotonic: float
    wall: float

    @classmethod
    def now(cls) -> Stamp:
        """The stamp of this moment."""
        return cls(time.monotonic(), time.time())

    @property
    def age(self) -> float:
        """Seconds since then."""
        return time.monotonic() - self.monotonic


#: Seconds between two ticks after which what comes may be too old; a busy machine may take 1.5 s for a tick.
_HELD_UP = 2.0


def _now() -> float:
    """Seconds of a clock that also goes on while the computer sleeps, where the system has one."""
    boot_time = getattr(time, "CLOCK_BOOTTIME", None)
    return time.monotonic() if boot_time is None else time.clock_gettime(boot_time)


class Expiry:
    """Whether this process was held up so lately that a command may have been given up: for servers of a robot.

    Args:
        settling: seconds for which commands are refused once it goes on; what was held back has come by then.
        now: seconds of a clock that only grows; by default one that goes on while the computer sleeps.
    """

    def __init__(self, settling: float, now: Callable[[], float] = _now) -> None:
        self._settling = settling
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
            self._held_up, self._until, self._is_new = gap, now + self._settling, True

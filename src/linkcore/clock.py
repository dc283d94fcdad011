"""The one clock and the one way to wait, the times at which bytes arrived, and the expiry of commands.

All ages, rates and deadlines use `now`, and everything that waits for a thread uses `wait` or one of its forms below.
Both also count the time for which this computer was suspended: `time.monotonic` does not on Linux and macOS, so a state
from before a suspend would count as fresh, and a timeout would start again where it was.

`now` looks up `read` in each call, so that it is also the simulated clock while time is simulated
(`linkcore.simulated`), even where it is kept as a default value.

`Expiry` is for a server that offers a robot in a middleware. If a process is suspended or gets no processor time, its
commands stay in the buffers of the middleware. They are delivered when the process resumes, and their client has
abandoned them by then. The middleware does not report the age of a command. But this process can measure whether it was
interrupted, without another clock: a tick is recorded ten times a second. If a tick is late, a command that arrives for
a while after the tick may have been sent before it.
"""

from __future__ import annotations

import contextlib
import math
import queue
import sys
import threading
import time
from collections.abc import Callable
from concurrent.futures import CancelledError, Future
from concurrent.futures import TimeoutError as FutureTimeout
from functools import partial
from typing import NamedTuple, TypeVar, cast

from .errors import LinkTimeout
from .names import StrictAttributes
from .pending_call import check_wanted, interruptible, pending_call

T = TypeVar("T")

# -- the clock -------------------------------------------------------------------------------------

if sys.platform == "win32":
    # Before CPython 3.13 `time.monotonic` has steps of 15.6 ms there. Both clocks include the time of a suspend.
    read: Callable[[], float] = time.perf_counter

    #: Smallest step of `now`, in seconds.
    RESOLUTION = time.get_clock_info("perf_counter").resolution
else:

    def _which() -> int:
        """The clock to read: on macOS and the BSDs CLOCK_MONOTONIC includes a suspend, on Linux only CLOCK_BOOTTIME."""
        boot_time: int | None = getattr(time, "CLOCK_BOOTTIME", None)
        if boot_time is not None:
            with contextlib.suppress(OSError):  # a sandbox might not have it
                time.clock_gettime(boot_time)
                return boot_time
        return time.CLOCK_MONOTONIC

    _CLOCK = _which()
    #: The same as `now`, but not a Python function, so a call takes about 370 instructions fewer. Use it only for work
    #: that is done for each packet. Call it as `clock.read()`, because simulated time replaces it here.
    read = partial(time.clock_gettime, _CLOCK)
    #: Smallest step of `now`, in seconds.
    RESOLUTION = time.clock_getres(_CLOCK)


def now() -> float:
    """Time in seconds, on a monotonic clock that includes the time for which this computer was suspended."""
    return read()


#: A faster clock, in seconds, to measure how long a call of this process took. Do not use it for an age, a rate or a
#: deadline, because it might not include a suspend. Call it as `clock.ticks()`: simulated time replaces it here.
ticks = time.perf_counter


def left(until: float) -> float:
    """Seconds left until the deadline `until` on this clock; 0.0 if it has passed."""
    return max(until - now(), 0.0)


# -- waiting ---------------------------------------------------------------------------------------

#: Whether Ctrl-C does not interrupt a wait for a lock: on Windows, before CPython 3.14.
_IS_DEAF = sys.platform == "win32" and sys.version_info < (3, 14)

#: Seconds that one call of the system waits at most. Such a call does not count the time of a suspend on Linux and
#: macOS, so a deadline that passed during a suspend is noticed so much later.
_SLICE = 0.1 if _IS_DEAF else 1.0

#: How long one call of the system should wait if the wait has no limit; None for no limit.
ENDLESS = _SLICE if _IS_DEAF else None

#: Seconds after which a wait that nothing can wake notices that its pending call was abandoned.
_LOOK = 0.05


def slice_of(seconds: float | None) -> float | None:
    """How long one call of the system should wait, of `seconds` in total; None if it may wait without a limit.

    For a loop that reads the clock itself after each call; everything else uses `wait`.
    """
    if seconds is None or seconds == math.inf:
        return ENDLESS
    return min(max(seconds, 0.0), _SLICE)


def wait(attempt: Callable[[float | None], object], timeout: float | None = None) -> bool:
    """Wait by calls of `attempt`, such as `event.wait`, until one returns something true; False if time is up.

    Args:
        attempt: Function that waits for the given number of seconds, or without a limit if given None.
        timeout: Maximum wait in seconds; None or infinity for no limit.

    Raises:
        Cancelled: If this thread makes a pending call that was abandoned; within 0.05 s.
    """
    if pending_call() is None:
        return _wait(attempt, timeout)
    until = math.inf if timeout is None else now() + timeout
    while not attempt(min(max(until - now(), 0.0), _LOOK)):
        check_wanted()
        if now() >= until:
            return False
    return True


def _wait(attempt: Callable[[float | None], object], timeout: float | None) -> bool:
    part = slice_of(timeout)
    if part is None or part == timeout:  # one call is enough
        return bool(attempt(part))
    until = math.inf if timeout is None else now() + timeout
    while not attempt(slice_of(until - now())):
        if now() >= until:
            return False
    return True


def sleep(seconds: float) -> None:
    """Sleep for `seconds`; returns at once if there are none left.

    Raises:
        Cancelled: If this thread makes a pending call that was abandoned.
    """
    if pending_call() is not None:
        is_abandoned = threading.Event()
        with interruptible(is_abandoned.set):
            _wait(is_abandoned.wait, seconds)
        return
    if seconds <= _SLICE:
        time.sleep(max(seconds, 0.0))
        return
    until = now() + seconds
    while (rest := until - now()) > 0.0:
        time.sleep(min(rest, _SLICE))


def get(items: queue.SimpleQueue[T], timeout: float | None = None) -> T:
    """Take the next item of a queue that only this thread reads.

    Raises:
        queue.Empty: If no item came within `timeout` seconds.
        Cancelled: If this thread makes a pending call that was abandoned.
    """
    got: list[T] = []

    def attempt(seconds: float | None) -> bool:
        with contextlib.suppress(queue.Empty):
            got.append(items.get(timeout=seconds))
        return bool(got)

    with interruptible(lambda: items.put(cast(T, None))):
        if not _wait(attempt, timeout):
            raise queue.Empty
    return got[0]


def is_done(future: Future[T], timeout: float | None = None) -> bool:
    """Wait until a future has a result, an error, or was cancelled; False if time is up.

    Raises:
        Cancelled: If this thread makes a pending call that was abandoned.
    """
    if pending_call() is not None and not future.done():
        is_over = threading.Event()
        future.add_done_callback(lambda future: is_over.set())
        with interruptible(is_over.set):
            _wait(is_over.wait, timeout)
        return future.done()

    def attempt(seconds: float | None) -> bool:
        with contextlib.suppress(CancelledError, FutureTimeout, TimeoutError):
            future.exception(seconds)
        return future.done()

    return _wait(attempt, timeout)


def join(thread: threading.Thread, timeout: float | None = None) -> bool:
    """Wait until a thread has ended; False if time is up."""

    def attempt(seconds: float | None) -> bool:
        thread.join(seconds)
        return not thread.is_alive()

    return wait(attempt, timeout)


# -- the times at which bytes arrived --------------------------------------------------------------


class Stamp(NamedTuple):
    """When the bytes of a packet arrived, on two clocks.

    Attributes:
        monotonic: `linkcore.clock.now()` in seconds. `age` is the time since then. Do not compare it with
            `time.monotonic()`, which differs from it once this computer was suspended.
        wall: `time.time()`, seconds since 1970 UTC; compare with it across machines.
    """

    monotonic: float
    wall: float

    @classmethod
    def now(cls) -> Stamp:
        """The stamp of this moment."""
        return cls(now(), time.time())

    @property
    def age(self) -> float:
        """Seconds since then, including those for which this computer was suspended."""
        return now() - self.monotonic


# -- commands that may be too old ------------------------------------------------------------------

#: Seconds between two ticks after which a command may be too old; a busy machine may take 1.5 s for a tick.
_HELD_UP = 2.0


class Expiry(StrictAttributes):
    """Check of a robot's server for commands that may be too old, because this process was recently interrupted.

    Args:
        settling: Seconds for which commands are rejected after the process resumes; delayed commands arrive by then.
        now: Monotonic clock, in seconds.
    """

    def __init__(self, settling: float, now: Callable[[], float] = now) -> None:
        self._settling = settling
        self._now = now
        self._lock = threading.Lock()
        self._ticked: float | None = None
        self._held_up = 0.0  # seconds, the last time
        self._until = -math.inf  # commands are refused
        self._is_new = False  # that it was held up, since the last tick

    def tick(self) -> bool:
        """Record, ten times a second, that this process runs; return whether it was interrupted since the last tick."""
        with self._lock:
            self._measure()
            was_held_up, self._is_new = self._is_new, False
            return was_held_up

    def check(self) -> None:
        """Reject a command that may have been sent before this process resumed.

        Raises:
            LinkTimeout: If this process was recently interrupted for more than 2 s. Nothing is done.
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

"""Clock of the library, functions that wait, time stamps of received bytes, and the expiry of commands.

All ages, rates and deadlines use `now`. Code that waits for a thread uses `wait`, or one of the functions below that
call it. Both count the time for which this computer was suspended. `time.monotonic` does not count it on Linux and
macOS, so a state from before a suspend would be considered fresh, and a timeout would ignore the time of the suspend.

`now` looks up `read` in each call. So `now` reads the simulated clock while time is simulated (`linkcore.simulated`),
even if a program has stored `now` as a default value.

`Expiry` is for a server that offers a robot in a middleware. If a process is suspended or gets no processor time, its
commands stay in the buffers of the middleware. The middleware delivers these commands when the process resumes,
although the client has abandoned them in the meantime. The middleware does not report the age of a command. But this
process can detect an interruption without another clock, because it records a tick ten times a second. If a tick is
late, commands that arrive shortly after the tick might have been sent before it.
"""

from __future__ import annotations

import contextlib
import math
import queue
import sys
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import CancelledError, Future
from concurrent.futures import TimeoutError as FutureTimeout
from functools import cache, partial
from typing import NamedTuple, TypeVar, cast

from .errors import LinkTimeout
from .names import StrictAttributes
from .pending_call import check_wanted, interruptible, pending_call

T = TypeVar("T")

# -- the clock -------------------------------------------------------------------------------------

if sys.platform == "win32":
    import ctypes

    # Before CPython 3.13, `time.monotonic` has steps of 15.6 ms on Windows. Both clocks include the time of a suspend.
    read: Callable[[], float] = time.perf_counter

    #: Smallest step of `now`, in seconds.
    RESOLUTION = time.get_clock_info("perf_counter").resolution
else:

    def _which() -> int:
        """Return the clock that includes a suspend."""
        boot_time: int | None = getattr(time, "CLOCK_BOOTTIME", None)
        if boot_time is not None:
            with contextlib.suppress(OSError):  # a sandbox might not provide this clock
                time.clock_gettime(boot_time)
                return boot_time
        # On macOS, both clocks below include a suspend (clock_gettime(3)), but CLOCK_MONOTONIC has steps of 1 us and
        # follows the adjustments of the wall clock. On Linux, CLOCK_MONOTONIC_RAW does not include a suspend.
        return time.CLOCK_MONOTONIC_RAW if sys.platform == "darwin" else time.CLOCK_MONOTONIC

    _CLOCK = _which()
    #: Function that returns the same time as `now`. Because it is not a Python function, a call takes about 370
    #: instructions fewer. Use it only for work that is done for each packet. Call it as `clock.read()`, because
    #: simulated time replaces this name in this module.
    read = partial(time.clock_gettime, _CLOCK)
    #: Smallest step of `now`, in seconds.
    RESOLUTION = time.clock_getres(_CLOCK)


def now() -> float:
    """Return the time in s, on a monotonic clock that includes the time of a suspend."""
    return read()


#: A faster clock, in seconds, to measure how long a call of this process took. Do not use it for an age, a rate or a
#: deadline, because it might not include a suspend. Call it as `clock.ticks()`, because simulated time replaces this
#: name in this module.
ticks = time.perf_counter


@contextlib.contextmanager
def fine_timer() -> Iterator[None]:
    """Let waits in the block end within about 1 ms on Windows, whose timer ticks every 15.6 ms by default.

    Without this function, only sleeps are exact (since CPython 3.11). On other systems, the function does nothing.
    """
    if sys.platform == "win32":
        multimedia = _multimedia()
        multimedia.timeBeginPeriod(1)
        try:
            yield
        finally:
            multimedia.timeEndPeriod(1)
    else:
        yield


if sys.platform == "win32":

    @cache
    def _multimedia() -> ctypes.WinDLL:
        """Load the library of the timer. It is loaded once, because a `WinDLL` is part of a reference cycle."""
        return ctypes.WinDLL("winmm")


def left(until: float) -> float:
    """Return the seconds left until the deadline `until` on this clock; 0.0 if it has passed."""
    return max(until - now(), 0.0)


# -- waiting ---------------------------------------------------------------------------------------

#: Whether Ctrl-C cannot interrupt a wait for a lock. This is true on Windows before CPython 3.14.
_IS_DEAF = sys.platform == "win32" and sys.version_info < (3, 14)

#: Longest wait of one system call, in s. On Linux and macOS such a call does not count the time of a suspend. So a
#: deadline that passed during a suspend is noticed at most this much later.
_SLICE = 0.1 if _IS_DEAF else 1.0

#: Longest wait of one system call in a wait without a limit; None if the system call has no limit either.
ENDLESS = _SLICE if _IS_DEAF else None

#: Interval in s at which `wait` checks whether its pending call was abandoned. The check is needed because nothing can
#: wake a waiting thread in this case.
_LOOK = 0.05


#: Time in s within which a started thread begins. If a thread has not begun by then, `join` assumes that a signal
#: interrupted its start.
_BEGINNING = 0.1


def slice_of(seconds: float | None) -> float | None:
    """Return the maximum wait of one system call, in s, as part of a longer wait of `seconds`.

    Return None if the system call may wait without a limit. Call this function only in a loop that reads the clock
    itself after each system call. All other code calls `wait`.
    """
    if seconds is None or seconds == math.inf:
        return ENDLESS
    return min(max(seconds, 0.0), _SLICE)


def wait(attempt: Callable[[float | None], object], timeout: float | None = None) -> bool:
    """Call `attempt`, such as `event.wait`, until it returns a true value.

    Return False after `timeout`.

    Args:
        attempt: Function that waits for the given number of seconds, or without a limit if given None.
        timeout: Maximum wait in seconds; None or infinity for no limit.

    Raises:
        Cancelled: If this thread is making a pending call that was abandoned. It is raised within 0.05 s.
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
    """Sleep for `seconds`; return at once if the number is not positive.

    Raises:
        Cancelled: If this thread is making a pending call that was abandoned.
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
    """Remove and return the next item of a queue that only this thread reads.

    Raises:
        queue.Empty: If no item arrives within `timeout` seconds.
        Cancelled: If this thread is making a pending call that was abandoned.
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
    """Wait until a future has a result or an error, or was cancelled.

    Return False after `timeout`.

    Raises:
        Cancelled: If this thread is making a pending call that was abandoned.
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
    """Wait until a thread has ended; return False after `timeout`.

    A signal can interrupt the start of a thread, which then never runs. A thread that has not begun after 0.1 s
    therefore counts as ended.

    Raises:
        RuntimeError: If `thread` is the current thread.
    """

    def attempt(seconds: float | None) -> bool:
        until = now() + _BEGINNING
        while True:
            try:
                thread.join(seconds)
            except RuntimeError:  # the thread has not begun
                if thread is threading.current_thread():
                    raise
                if now() >= until:
                    return True
                time.sleep(0.001)
            else:
                return not thread.is_alive()

    return wait(attempt, timeout)


# -- the times at which bytes arrived --------------------------------------------------------------


class Stamp(NamedTuple):
    """Time at which the bytes of a packet arrived, on two clocks.

    Attributes:
        monotonic: Time of `linkcore.clock.now()`, in s. `age` is the time since then. Do not compare it with
            `time.monotonic()`, because the two differ after this computer was suspended.
        wall: Time of `time.time()`, in s since 1970 UTC. Use it to compare times between machines.
    """

    monotonic: float
    wall: float

    @classmethod
    def now(cls) -> Stamp:
        """Return the stamp of this moment."""
        return cls(now(), time.time())

    @property
    def age(self) -> float:
        """Seconds since the stamp, including the time for which this computer was suspended."""
        return now() - self.monotonic


# -- commands that might be too old ------------------------------------------------------------------

#: Time in s between two ticks above which a command might be too old. On a busy computer, two ticks can be 1.5 s apart
#: even without an interruption.
_HELD_UP = 2.0


class Expiry(StrictAttributes):
    """Check that rejects commands that might be too old, because this process was recently interrupted.

    Args:
        settling: Seconds for which commands are rejected after the process resumes. All delayed commands should arrive
            in this time.
        now: Monotonic clock, in seconds.
    """

    def __init__(self, settling: float, now: Callable[[], float] = now) -> None:
        self._settling = settling
        self._now = now
        self._lock = threading.Lock()
        self._ticked: float | None = None
        self._held_up = 0.0  # duration of the last interruption, in s
        self._until = -math.inf  # commands are rejected until this time
        self._is_new = False  # whether an interruption has happened since the last tick

    def tick(self) -> bool:
        """Record that this process is running; return whether it was interrupted since the last tick.

        Call it ten times a second.
        """
        with self._lock:
            self._measure()
            was_held_up, self._is_new = self._is_new, False
            return was_held_up

    def check(self) -> None:
        """Reject a command that might have been sent before this process resumed.

        Raises:
            LinkTimeout: If this process was recently interrupted for more than 2 s. Nothing is done.
        """
        with self._lock:
            if self._ticked is not None:  # before the first tick no interruption can be detected
                self._measure()
            left = self._until - self._now()
        if left > 0.0:
            raise LinkTimeout(
                f"this process was interrupted for {self._held_up:.1f} s, so the command might be that old, and its "
                f"client might have abandoned it; nothing was done, and commands are accepted again in {left:.1f} s"
            )

    def _measure(self) -> None:
        now = self._now()
        gap = 0.0 if self._ticked is None else now - self._ticked
        self._ticked = now
        if gap > _HELD_UP:
            self._held_up, self._until, self._is_new = gap, now + self._settling, True

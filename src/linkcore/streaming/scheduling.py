"""Real-time options of the operating system and of the interpreter, for threads that must not be late.

A thread that reads or drives a robot needs little processor time, but it needs it immediately. It might be late because
of the system's scheduler, swapped-out memory, the garbage collector, or another thread that holds the interpreter's
lock. There is an option for each of these causes, and most options need special rights. Refused options are reported
once.
"""

from __future__ import annotations

import contextlib
import gc as collector
import logging
import os
import sys
import threading
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Literal

from .. import clock
from ..errors import BadValue

_log = logging.getLogger(__name__)

#: Flags of mlockall(2): current pages, and future pages.
_MCL_CURRENT, _MCL_FUTURE = 1, 2


@dataclass(frozen=True)
class RealtimeReport:
    """Result of `realtime_options`.

    Attributes:
        granted: Names of the options that are in force.
        refused: Name of each refused option -> the reason, and the consequence.
    """

    granted: tuple[str, ...]
    refused: dict[str, str]

    def __str__(self) -> str:
        granted = f"in force: {', '.join(self.granted) or 'nothing'}"
        return "; ".join([granted, *(f"{name} was refused: {why}" for name, why in self.refused.items())])


@dataclass(frozen=True)
class _Options:
    priority: int | None = None
    cpus: frozenset[int] | None = None


class _Threads:
    """Threads that must not be late, and their options."""

    def __init__(self) -> None:
        # Re-entrant, because a signal handler may enter a block; it leaves the block before it returns.
        self._lock = threading.RLock()
        self._numbers: dict[int, int] = {}  # native number of each thread -> number of its entered blocks
        self._options = _Options()

    @contextlib.contextmanager
    def urgent(self) -> Iterator[None]:
        """Give the options to the current thread while it is in the block, and fine timers to the process."""
        number = threading.get_native_id()
        with self._lock:
            self._numbers[number] = self._numbers.get(number, 0) + 1
            if self._numbers[number] == 1 and self._options != _Options():
                _give(number, self._options)
        try:
            with clock.fine_timer():
                yield
        finally:
            with self._lock:
                left = self._numbers[number] = self._numbers[number] - 1
                if not left:
                    self._numbers.pop(number, None)  # a signal handler might have removed it already
                    if self._options != _Options():
                        _give(number, _Options())

    def use(self, options: _Options) -> dict[str, str]:
        """Give the options to all current and future threads; return refused option -> reason."""
        with self._lock:
            refused = _probe(options)
            self._options = _Options(
                None if "priority" in refused else options.priority, None if "cpu" in refused else options.cpus
            )
            for number in list(self._numbers):
                _give(number, self._options)
        return refused


_threads = _Threads()
urgent = _threads.urgent
if sys.platform == "linux":
    _everywhere = os.sched_getaffinity(0)
else:
    _everywhere = set(range(os.cpu_count() or 1))
_reported: set[frozenset[str]] = set()


def realtime_options(
    priority: int | None = None,
    cpu: int | Iterable[int] | None = None,
    lock_memory: bool = False,
    gc: bool | Literal["freeze"] | None = None,
    switch_interval: float | None = None,
) -> RealtimeReport:
    """Request real-time options for the current and future threads that read and drive robots.

    These threads are the reader of each stream, which also sends the set-points of `follow`, the thread in the block of
    a `servo`, and the thread of an event loop that reads a stream. Each call replaces the `priority`, `cpu` and
    `lock_memory` of the previous call. If the system refuses an option, this is reported, and logged once per process.
    The program continues without it.

    Args:
        priority: Priority of the scheduling policy SCHED_FIFO, 1 to 99. Such a thread runs before every normal thread.
            Linux only; needs CAP_SYS_NICE or a limit (``ulimit -r``).
        cpu: Number of a processor, or several numbers. The threads run only on these processors. Linux only.
        lock_memory: Whether no page of this process may be swapped out. Linux only; needs a limit (``ulimit -l``).
        gc: Garbage collection of reference cycles: False switches it off, True switches it on, "freeze" excludes all
            current objects from it, and None leaves it unchanged.
        switch_interval: Seconds after which a thread that computes in Python must let other threads run; Python's
            default is 0.005 (`sys.setswitchinterval`). Each time that another thread needs the interpreter, it waits at
            most this long. None leaves the value unchanged.

    Raises:
        BadValue: If the priority, the processor or the interval is out of range.
    """
    if priority is not None and not (isinstance(priority, int) and 1 <= priority <= 99):
        raise BadValue(f"priority={priority!r}; expected 1 to 99, or None for the normal priority")
    if gc not in (True, False, None, "freeze"):
        raise BadValue(f"gc={gc!r}; expected True, False, 'freeze' or None")
    if switch_interval is not None and not 1e-5 <= switch_interval <= 1.0:
        raise BadValue(f"switch_interval={switch_interval!r}; expected 0.00001 to 1 s")
    refused = _threads.use(_Options(priority, _cpus(cpu)))
    asked = {
        "priority": priority is not None,
        "cpu": cpu is not None,
        "lock_memory": lock_memory,
        "gc": gc is not None,
        "switch_interval": switch_interval is not None,
    }
    refused |= _lock_memory(lock_memory)
    if gc is not None:
        (collector.disable if gc is False else collector.enable)()
        if gc == "freeze":
            collector.collect()
            collector.freeze()
    if switch_interval is not None:
        sys.setswitchinterval(switch_interval)
    report = RealtimeReport(
        tuple(name for name, is_asked in asked.items() if is_asked and name not in refused), refused
    )
    kinds = frozenset(refused)
    if refused and kinds not in _reported:
        _reported.add(kinds)
        _log.warning("real-time options: %s", report)
    return report


def _cpus(cpu: int | Iterable[int] | None) -> frozenset[int] | None:
    if cpu is None:
        return None
    cpus = frozenset((cpu,)) if isinstance(cpu, int) else frozenset(cpu)
    if not cpus or not cpus <= _everywhere:
        raise BadValue(f"cpu={cpu!r}; expected processors from {', '.join(map(str, sorted(_everywhere)))}")
    return cpus


def _probe(options: _Options) -> dict[str, str]:
    """Try the options on this thread, and reset them; return refused option -> reason."""
    number = threading.get_native_id()

    def use(one: _Options) -> None:
        _set(number, one)
        _give(number, _Options())

    refused: dict[str, str] = {}
    if options.priority is not None:
        meaning = "the threads compete with all other threads, and might be late by milliseconds on a busy machine"
        refused |= _refusal("priority", meaning, lambda: use(_Options(priority=options.priority)))
    if options.cpus is not None:
        meaning = "the system moves the threads between processors, and their caches are cold after each move"
        refused |= _refusal("cpu", meaning, lambda: use(_Options(cpus=options.cpus)))
    return refused


def _refusal(name: str, meaning: str, ask: Callable[[], object]) -> dict[str, str]:
    """Return name -> reason and consequence if the option is refused; empty if it is granted."""
    try:
        ask()
    except (OSError, NotImplementedError) as error:
        return {name: f"{error}; {meaning}"}
    return {}


def _give(number: int, options: _Options) -> None:
    """Set options that `_probe` found to be granted. Does nothing if the thread has just ended."""
    with contextlib.suppress(OSError, NotImplementedError):
        _set(number, options)


def _set(number: int, options: _Options) -> None:
    """Set the options of one thread; None restores the normal value.

    Raises:
        OSError: If the system refuses an option.
        NotImplementedError: If this system has no such option.
    """
    if sys.platform == "linux":
        os.sched_setaffinity(number, options.cpus or _everywhere)
        if options.priority is None:
            os.sched_setscheduler(number, os.SCHED_OTHER, os.sched_param(0))
        else:
            # Threads and processes that such a thread starts must not inherit the policy.
            policy = os.SCHED_FIFO | os.SCHED_RESET_ON_FORK
            os.sched_setscheduler(number, policy, os.sched_param(options.priority))
    elif options != _Options():
        raise NotImplementedError(f"not implemented on {sys.platform}")


def _lock_memory(is_wanted: bool) -> dict[str, str]:
    global _is_locked
    if not is_wanted and not _is_locked:
        return {}
    meaning = "a swapped-out page must be read from the disk when it is needed, which takes milliseconds"
    refused = _refusal("lock_memory", meaning, lambda: _call_mlock(is_wanted))
    _is_locked = is_wanted and not refused
    return refused if is_wanted else {}


_is_locked = False


def _call_mlock(is_wanted: bool) -> None:
    """Call mlockall or munlockall.

    Raises:
        OSError: If the system refuses it.
        NotImplementedError: If this is not Linux. The kernel of macOS answers both calls with ENOSYS.
    """
    if sys.platform == "linux":
        import ctypes

        libc = ctypes.CDLL(None, use_errno=True)
        result = libc.mlockall(_MCL_CURRENT | _MCL_FUTURE) if is_wanted else libc.munlockall()
        if result:
            number = ctypes.get_errno()
            raise OSError(number, f"{os.strerror(number)} (errno {number})")
    else:
        raise NotImplementedError(f"not implemented on {sys.platform}")

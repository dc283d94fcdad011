"""Real-time scheduling: what the operating system and the interpreter can do for threads that must not be late.

A thread that reads a robot, or leads one, needs little of a processor, but at once. Whether it gets that is up to the
system's scheduler, to the memory that may have been swapped out, to the garbage collector, and to whichever thread of
this program holds the interpreter's lock. Each can be asked for; most need rights. What cannot be had is reported once.
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

from ..errors import BadValue

_log = logging.getLogger(__name__)

#: Of mlockall(2): the pages that there are, and those to come.
_MCL_CURRENT, _MCL_FUTURE = 1, 2


@dataclass(frozen=True)
class RealtimeReport:
    """What became of `realtime_options`.

    Attributes:
        granted: names of the options that are in force.
        refused: name -> why it could not be had, and what that means.
    """

    granted: tuple[str, ...]
    refused: dict[str, str]

    def __str__(self) -> str:
        granted = f"in force: {', '.join(self.granted) or 'nothing'}"
        return "; ".join([granted, *(f"{name} could not be had: {why}" for name, why in self.refused.items())])


@dataclass(frozen=True)
class _Options:
    priority: int | None = None
    cpus: frozenset[int] | None = None


class _Threads:
    """The threads that must not be late, and what they are given."""

    def __init__(self) -> None:
        self._lock = (
            threading.RLock()
        )  # re-entrant: a signal handler may enter a block, and leaves it before it returns
        self._numbers: dict[int, int] = {}  # of the system -> how often it was entered
        self._options = _Options()

    @contextlib.contextmanager
    def urgent(self) -> Iterator[None]:
        """The current thread must not be late while it is in the block."""
        number = threading.get_native_id()
        with self._lock:
            self._numbers[number] = self._numbers.get(number, 0) + 1
            if self._numbers[number] == 1 and self._options != _Options():
                _give(number, self._options)
        try:
            yield
        finally:
            with self._lock:
                left = self._numbers[number] = self._numbers[number] - 1
                if not left:
                    self._numbers.pop(number, None)  # a signal handler may have done so just now
                    if self._options != _Options():
                        _give(number, _Options())

    def use(self, options: _Options) -> dict[str, str]:
        """Give these to all of them, and to those to come; name -> why it was refused."""
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
_everywhere = os.sched_getaffinity(0) if sys.platform == "linux" else set()
_reported: set[frozenset[str]] = set()


def realtime_options(
    priority: int | None = None,
    cpu: int | Iterable[int] | None = None,
    lock_memory: bool = False,
    gc: bool | Literal["freeze"] | None = None,
    switch_interval: float | None = None,
) -> RealtimeReport:
    """Ask for what keeps the threads that read and lead robots from being late, those that run and those to come.

    They are: the reader of each stream, which also sends the set-points of `follow`; the thread in the block of a
    `servo`; and that of an event loop which reads. Each call says all of it anew. What the system refuses is logged
    once in a process and stands in the report; the program goes on without it.

    Args:
        priority: 1 to 99, of the scheduling policy SCHED_FIFO: such a thread runs before every usual one. Linux; needs
            CAP_SYS_NICE or a limit (``ulimit -r``).
        cpu: number of a processor, or several, that they run on alone as far as this process goes. Linux.
        lock_memory: no page of this process is swapped out. Linux and macOS; needs a limit (``ulimit -l``).
        gc: False switches the collection of cyclic garbage off, "freeze" leaves out what there is now, True switches it
            on; None leaves it as it is.
        switch_interval: seconds after which a thread that computes in Python has to let others in, 0.005 unless set
            (`sys.setswitchinterval`): the longest that another thread is kept waiting by it, again for each of its
            steps. None leaves it as it is.

    Raises:
        BadValue: no such priority, processor or interval.
    """
    if priority is not None and not (isinstance(priority, int) and 1 <= priority <= 99):
        raise BadValue(f"priority={priority!r}; expected 1 to 99, or None for that of every thread")
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
    there = _everywhere or set(range(os.cpu_count() or 1))
    if not cpus or not cpus <= there:
        raise BadValue(f"cpu={cpu!r}; this process may run on {', '.join(map(str, sorted(there)))}")
    return cpus


def _probe(options: _Options) -> dict[str, str]:
    """Try the options on this thread, and take them back; name -> why it was refused."""
    number = threading.get_native_id()

    def use(one: _Options) -> None:
        _set(number, one)
        _give(number, _Options())

    refused: dict[str, str] = {}
    if options.priority is not None:
        meaning = (
            "the threads take turns with all others of this machine, and can be late by milliseconds where it is busy"
        )
        refused |= _refusal("priority", meaning, lambda: use(_Options(priority=options.priority)))
    if options.cpus is not None:
        meaning = "the threads run where the system puts them, and find the caches cold when it moves them"
        refused |= _refusal("cpu", meaning, lambda: use(_Options(cpus=options.cpus)))
    return refused


def _refusal(name: str, meaning: str, ask: Callable[[], object]) -> dict[str, str]:
    """name -> why it was refused, and what that means; empty if it was not."""
    try:
        ask()
    except (OSError, NotImplementedError) as error:
        return {name: f"{error}; {meaning}"}
    return {}


def _give(number: int, options: _Options) -> None:
    """Set what `_probe` found to be granted; of a thread that has just ended, nothing."""
    with contextlib.suppress(OSError, NotImplementedError):
        _set(number, options)


def _set(number: int, options: _Options) -> None:
    """Set the options of one thread; what is None is as usual.

    Raises:
        OSError, NotImplementedError: it may not be, or there is no such thing here.
    """
    if sys.platform != "linux":
        if options == _Options():
            return
        raise NotImplementedError(f"{sys.platform} has no such call, or none that was tried")
    os.sched_setaffinity(number, options.cpus or _everywhere)
    if options.priority is None:
        os.sched_setscheduler(number, os.SCHED_OTHER, os.sched_param(0))
    else:
        # What such a thread starts does not inherit it.
        policy = os.SCHED_FIFO | os.SCHED_RESET_ON_FORK
        os.sched_setscheduler(number, policy, os.sched_param(options.priority))


def _lock_memory(is_wanted: bool) -> dict[str, str]:
    global _is_locked
    if not is_wanted and not _is_locked:
        return {}
    meaning = "a page that was swapped out is read from the disk when it is needed, which takes milliseconds"
    refused = _refusal("lock_memory", meaning, lambda: _call_mlock(is_wanted))
    _is_locked = is_wanted and not refused
    return refused if is_wanted else {}


_is_locked = False


def _call_mlock(is_wanted: bool) -> None:
    """mlockall or munlockall.

    Raises:
        OSError: it was refused.
        NotImplementedError: not on this system.
    """
    if sys.platform == "win32":
        raise NotImplementedError("Windows has no such call")
    import ctypes

    libc = ctypes.CDLL(None, use_errno=True)
    result = libc.mlockall(_MCL_CURRENT | _MCL_FUTURE) if is_wanted else libc.munlockall()
    if result:
        number = ctypes.get_errno()
        raise OSError(number, f"{os.strerror(number)} (errno {number})")

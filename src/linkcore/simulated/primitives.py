"""Replacements for locks, semaphores, simple queues and threads of the standard library, which use a scheduler.

Condition, Event, Barrier, Queue and futures are Python code that uses these classes, so they need no replacement. A
thread outside of the simulation, such as pytest's own, can use these objects too; it waits in real time.
"""

from __future__ import annotations

import _thread
import contextvars
import queue
import sys
import threading
import time
from collections import deque
from collections.abc import Callable
from types import GenericAlias
from typing import Any

from .scheduler import Ended, Scheduler, Task, TaskComputer, current

#: Poll interval, in s, of a thread outside of the simulation.
_LOOK = 0.001


_real_sleep = time.sleep
_real_monotonic = time.monotonic


class _Waited:
    """Object for which tasks can wait."""

    def __init__(self) -> None:
        self._waiters: deque[Task] = deque()

    def _yield(self) -> None:
        """Wake one of the waiting tasks, and let another task run."""
        scheduler = current()
        if scheduler is not None:
            if self._waiters:
                scheduler.wake_one(self._waiters)
            scheduler.step()


class _Held(_Waited):
    """Lock that a `with` block can hold."""

    _take: Callable[[], bool]
    release: Callable[[], None]

    def acquire(self, blocking: bool = True, timeout: float = -1) -> bool:
        scheduler = current()
        if scheduler is None:
            return _from_outside(self._take, blocking, timeout)
        scheduler.step()
        if self._take():
            return True
        if not blocking:
            return False
        deadline = None if timeout < 0 else scheduler.deadline(timeout)
        while not self._take():
            if not scheduler.wait(deadline, self._waiters):
                return False
        return True

    def __enter__(self) -> bool:
        return self.acquire()

    def __exit__(self, *exc: object) -> None:
        self.release()

    def _at_fork_reinit(self) -> None:
        self.__init__()  # type: ignore[misc]


class Lock(_Held):
    """Replacement for `threading.Lock`."""

    def __init__(self) -> None:
        self._is_locked = False
        super().__init__()

    def release(self) -> None:
        if not self._is_locked:
            raise RuntimeError("release unlocked lock")
        self._is_locked = False
        self._yield()

    def locked(self) -> bool:
        return self._is_locked

    def _take(self) -> bool:
        if self._is_locked:
            return False
        self._is_locked = True
        return True


class RLock(_Held):
    """Replacement for `threading.RLock`, with the methods that `threading.Condition` needs."""

    def __init__(self) -> None:
        self._owner = 0
        self._count = 0
        super().__init__()

    def acquire(self, blocking: bool = True, timeout: float = -1) -> bool:
        if self._is_owned():
            self._count += 1
            return True
        return super().acquire(blocking, timeout)

    def release(self) -> None:
        if not self._is_owned():
            raise RuntimeError("cannot release un-acquired lock")
        self._count -= 1
        if not self._count:
            self._free()

    def locked(self) -> bool:  # since CPython 3.14, in which `threading.Condition` uses it
        return self._count > 0

    def _free(self) -> None:
        self._owner = 0
        self._yield()

    def _take(self) -> bool:
        if self._owner:
            return False
        self._owner, self._count = _thread.get_ident(), 1
        return True

    def _is_owned(self) -> bool:
        return self._owner == _thread.get_ident()

    def _release_save(self) -> int:
        count, self._count = self._count, 0
        self._free()
        return count

    def _acquire_restore(self, count: int) -> None:
        self.acquire()
        self._count = count

    def _recursion_count(self) -> int:
        return self._count if self._is_owned() else 0


class Semaphore(threading.Semaphore):
    """Replacement for `threading.Semaphore`. A release without a waiting task is not a step.

    The threads of `concurrent.futures` release a semaphore for each call. Since Python 3.12, they do so only when they
    are idle.
    """

    def release(self, n: int = 1) -> None:
        condition: Any = self._cond  # type: ignore[attr-defined]
        # The task that holds the lock of the condition might be about to wait.
        if n < 1 or current() is None or condition._waiters or condition._lock.locked():
            super().release(n)
        else:
            self._value += n


def _from_outside(take: Any, blocking: bool, timeout: float) -> bool:
    """Take a lock in a thread outside of the simulation, or after the simulation has ended."""
    until = None if timeout < 0 else _real_monotonic() + timeout
    while not take():
        if not blocking or (until is not None and _real_monotonic() >= until):
            return False
        _real_sleep(_LOOK)
    return True


class SimpleQueue(_Waited):
    """Replacement for `queue.SimpleQueue`. Each call is a step.

    The first check that finds the queue empty is not a step, because the threads of `concurrent.futures` do such checks
    since Python 3.12.
    """

    __class_getitem__: Any = classmethod(GenericAlias)

    def __init__(self) -> None:
        super().__init__()
        self._items: deque[Any] = deque()
        self._looked = -1

    def put(self, item: Any, block: bool = True, timeout: float | None = None) -> None:
        self._items.append(item)
        self._yield()

    put_nowait = put

    def get(self, block: bool = True, timeout: float | None = None) -> Any:
        if timeout is not None and timeout < 0:
            raise ValueError("'timeout' must be a non-negative number")
        scheduler = current()
        if scheduler is None:
            if not _from_outside(lambda: bool(self._items), block, -1 if timeout is None else timeout):
                raise queue.Empty
            return self._items.popleft()
        if not block and self.empty():
            raise queue.Empty
        scheduler.step()
        if block:
            deadline = scheduler.deadline(timeout)
            while not self._items and scheduler.wait(deadline, self._waiters):
                pass
        if not self._items:
            raise queue.Empty
        return self._items.popleft()

    def get_nowait(self) -> Any:
        return self.get(block=False)

    def empty(self) -> bool:
        if self._items:
            return False
        scheduler = current()
        if scheduler is not None:
            if self._looked == scheduler.steps:  # otherwise a loop that only calls `empty` would never end
                scheduler.step()
            self._looked = scheduler.steps
        return True

    def qsize(self) -> int:
        return 0 if self.empty() else len(self._items)


_start, _join, _is_alive = threading.Thread.start, threading.Thread.join, threading.Thread.is_alive


def _task(thread: threading.Thread) -> Task | None:
    """Return the task of a thread; None if it does not belong to the simulation."""
    return getattr(thread, "_simulated", None)


def numbering(init: Callable[..., None]) -> Callable[..., None]:
    """Return an `__init__` for a class whose objects use a number as their hash."""

    def wrapped(it: Any, *args: Any, **options: Any) -> None:
        scheduler = current()
        if scheduler is not None:
            scheduler.numbered += 1
            it._number = scheduler.numbered
        init(it, *args, **options)

    return wrapped


def hash_(it: Any) -> int:
    """Replacement for `__hash__`, which does not depend on the address of the object.

    Pools join threads, and asyncio cancels tasks, in the order of a set.
    """
    return getattr(it, "_number", None) or object.__hash__(it)


def start(thread: threading.Thread) -> None:
    """Replacement for `Thread.start`. If a simulated thread starts the thread, it takes part in the simulation."""
    scheduler = current()
    if scheduler is None:
        _start(thread)
        return
    if _task(thread) is not None or thread.ident is not None:
        raise RuntimeError("threads can only be started once")
    if not scheduler.running.computer.starts_threads:
        raise RuntimeError("can't start new thread")
    start_on(scheduler, thread, scheduler.running.computer)
    scheduler.step()


def start_on(
    scheduler: Scheduler, thread: threading.Thread, computer: TaskComputer, *, is_never_held: bool = False
) -> None:
    """Start a thread of a computer. A call of `Scheduler.call_at` may do this, because it does not wait."""
    task = scheduler.spawn(thread.name, computer, is_never_held=is_never_held)
    thread._simulated = task  # type: ignore[attr-defined]
    if getattr(thread, "_context", thread) is None:
        # CPython 3.14 runs a thread in a context that `Thread.start` has set. In earlier versions, each thread begins
        # with an empty context.
        inherits = getattr(sys.flags, "thread_inherit_context", False)
        thread._context = contextvars.copy_context() if inherits else contextvars.Context()  # type: ignore[attr-defined]
    # `_bootstrap_inner` removes this entry again.
    threading._limbo[thread] = thread  # type: ignore[attr-defined]
    task.ident = _thread.start_new_thread(_take_part, (scheduler, task, thread))


def _take_part(scheduler: Scheduler, task: Task, thread: threading.Thread) -> None:
    report = thread._invoke_excepthook  # type: ignore[attr-defined]
    thread._invoke_excepthook = lambda *args: isinstance(sys.exc_info()[1], Ended) or report(*args)  # type: ignore[attr-defined]
    try:
        scheduler.begin(task)
        thread._bootstrap_inner()  # type: ignore[attr-defined]
    except Ended:
        threading._limbo.pop(thread, None)  # type: ignore[attr-defined]
    finally:
        if thread.ident is not None:  # the thread had begun
            _set_done(thread)
        scheduler.finish(task)


def _set_done(thread: threading.Thread) -> None:
    """Set the state that the real `is_alive` and `join` read after the simulation.

    Before CPython 3.13, this state is part of the thread's state.
    """
    for name in vars(thread).keys() & {"_handle", "_os_thread_handle"}:
        done = threading._make_thread_handle(thread.ident)  # type: ignore[attr-defined]
        done._set_done()
        setattr(thread, name, done)


def join(thread: threading.Thread, timeout: float | None = None) -> None:
    """Replacement for `Thread.join`."""
    task, scheduler = _task(thread), current()
    if task is None:
        _join(thread, timeout)
    elif scheduler is not None:
        if task is scheduler.running:
            raise RuntimeError("cannot join current thread")
        scheduler.step()
        if not task.is_over:
            scheduler.wait(scheduler.deadline(timeout), task.joiners)


def is_alive(thread: threading.Thread) -> bool:
    """Replacement for `Thread.is_alive`."""
    task = _task(thread)
    return _is_alive(thread) if task is None else not task.is_over


#: Methods of `threading.Thread` that are replaced.
METHODS = {"__init__": numbering(threading.Thread.__init__), "start": start, "join": join, "is_alive": is_alive}

"""Functions and threads for programs with an asyncio event loop: waiting in the loop, and calls that block."""

from __future__ import annotations

import asyncio
import atexit
import contextlib
import math
import os
import threading
import weakref
from collections import deque
from collections.abc import Callable, Coroutine, Generator
from concurrent.futures import Future
from functools import partial
from typing import Any, Generic, Protocol, TypeVar

from . import clock
from .errors import Closed, LocalError
from .names import StrictAttributes
from .pending_call import PendingCall
from .threads import started

T = TypeVar("T")


class _Closing(Protocol):
    async def close(self) -> None: ...


C = TypeVar("C", bound=_Closing)


class Opening(StrictAttributes, Generic[C]):
    """Result of `connect_async`, to be awaited or entered.

    Write ``robot = await opening``, or ``async with opening as robot``, which closes the robot.

    Args:
        open: Function that connects; called once for each use.
    """

    __slots__ = ("_open", "_opened")

    def __init__(self, open: Callable[[], Coroutine[Any, Any, C]]) -> None:
        self._open = open
        self._opened: C | None = None

    def _hint(self, name: str) -> str:
        how = "'async with connect_async(...) as robot:' or 'robot = await connect_async(...)'"
        return f"; it is not connected yet; write {how}"

    def __await__(self) -> Generator[Any, None, C]:
        return self._open().__await__()

    async def __aenter__(self) -> C:
        self._opened = await self._open()
        return self._opened

    async def __aexit__(self, *exc: object) -> None:
        if self._opened is not None:
            await self._opened.close()


def running_loop(what: str) -> asyncio.AbstractEventLoop:
    """Return the event loop that runs in this thread.

    Raises:
        LocalError: If no event loop runs in this thread; the message names `what` as the part that needs it.
    """
    try:
        return asyncio.get_running_loop()
    except RuntimeError:
        raise LocalError(
            f"{what} needs a running asyncio event loop, and none runs in this thread; "
            "from trio, curio or a plain thread, use the blocking calls in a separate thread"
        ) from None


async def within(seconds: float | None, future: asyncio.Future[Any]) -> bool:
    """Wait until a future is done; return False after `seconds`.

    The future is neither cancelled nor read. A task that is cancelled while it waits here ends at once, even if the
    future becomes done in the same iteration of the loop. In this case `asyncio.wait_for` of Python 3.11 and older
    returns, and the task continues (bpo-42130).

    Args:
        seconds: Maximum wait in s; None waits forever.
        future: Future to wait for.
    """
    part = clock.slice_of(seconds)
    if part is None or part == seconds:  # one call is enough
        await asyncio.wait({future}, timeout=part)
        return future.done()
    until = math.inf if seconds is None else clock.now() + seconds
    while not future.done() and (left := until - clock.now()) > 0.0:
        await asyncio.wait({future}, timeout=clock.slice_of(left))
    return future.done()


async def finished(ending: asyncio.Future[T]) -> T:
    """Wait until a future is done, and return its result, even if the current task is cancelled in the meantime.

    If the task is cancelled, it ends when the future is done.
    """
    try:
        await asyncio.wait({ending})
    except asyncio.CancelledError:
        await asyncio.wait({ending})
        raise
    try:
        return ending.result()
    finally:
        del ending  # an error refers to this frame, and the future refers to the error


def happened(future: asyncio.Future[None]) -> None:
    """Mark a future that represents an event as done; idempotent like `asyncio.Event.set`."""
    if not future.done():
        future.set_result(None)


def ended(future: Future[Any], loop: asyncio.AbstractEventLoop) -> asyncio.Future[None]:
    """Return a future of `loop` that is done one iteration after `future`, which any thread may end.

    `future` itself is not changed. `asyncio.wrap_future` does not wait for an iteration of the loop on Python 3.14 and
    later if the thread of the loop ends `future`.
    """
    end = loop.create_future()

    def end_it(_: object) -> None:
        with contextlib.suppress(RuntimeError):  # the loop is closed
            loop.call_soon_threadsafe(happened, end)

    future.add_done_callback(end_it)
    return end


class _Threads:
    """Threads that execute calls in the order in which they were submitted.

    Args:
        name: Name of the threads.
        most: Maximum number of threads; `math.inf` for no limit.
        kept: Number of threads that keep running when there is nothing to do.
    """

    def __init__(self, name: str, most: float, kept: float) -> None:
        self._name = name
        self._most = most
        self._kept = kept
        self._calls: deque[tuple[Future[Any], Callable[[], Any]]] = deque()
        self._changed = threading.Condition()
        self._idle = 0
        self._is_closed = False
        self._threads: set[threading.Thread] = set()

    def start(self, count: int) -> None:
        """Start `count` threads now.

        Raises:
            LocalError: If the system has no thread left.
        """
        with self._changed:
            for _ in range(count):
                self._start()

    def submit(self, call: Callable[[], T], *, waits_for_thread: bool = False) -> Future[T]:
        """Make a call in an idle thread, or in a new thread if the maximum is not reached.

        Args:
            call: The call.
            waits_for_thread: Whether the call waits for a busy thread if no new thread can be started.

        Raises:
            Closed: If the threads were closed.
            LocalError: If the system has no thread left. The call is not made.
        """
        future: Future[T] = Future()
        with self._changed:
            if self._is_closed:
                raise Closed(f"{self._name} was closed")
            if self._idle <= len(self._calls) and len(self._threads) < self._most:
                try:
                    self._start()
                except LocalError:
                    if not (self._threads and waits_for_thread):
                        raise
            self._calls.append((future, call))
            self._changed.notify()
        return future

    def close(self) -> None:
        """Accept no more calls. Submitted calls are still made. Does not wait. Idempotent."""
        with self._changed:
            self._is_closed = True
            self._changed.notify_all()

    def drop(self) -> None:
        """Cancel the calls that no thread has begun."""
        with self._changed:
            dropped = list(self._calls)
            self._calls.clear()
        for future, _ in dropped:
            future.cancel()

    def join(self, timeout: float) -> None:
        """Wait until the threads have ended, after `close`."""
        until = clock.now() + timeout
        for thread in list(self._threads):
            clock.join(thread, clock.left(until))

    def _start(self) -> None:
        thread = threading.Thread(target=self._run, name=f"{self._name}_{len(self._threads)}", daemon=True)
        self._threads.add(thread)
        try:
            started(thread)
        except BaseException:
            self._threads.discard(thread)
            raise

    def _run(self) -> None:
        while True:
            with self._changed:
                while not self._calls:
                    if self._is_closed or self._idle >= self._kept:
                        self._threads.discard(threading.current_thread())
                        return
                    self._idle += 1
                    try:
                        self._changed.wait()
                    finally:
                        self._idle -= 1
                future, call = self._calls.popleft()
            if future.set_running_or_notify_cancel():
                try:
                    future.set_result(call())
                except BaseException as error:
                    future.set_exception(error)
            del future, call  # an idle thread must not keep a robot object alive


class Workers:
    """Threads of one robot for its calls, and separate threads for stops, which never wait for a call.

    A thread for calls is started when it is needed, and keeps running.

    Args:
        name: Name of the threads.
        most: Maximum number of calls at the same time; 1 makes calls one after the other.
        stopping: Number of threads for stops that are started immediately, so that they cannot fail to start later.
            More threads are started while all of them are busy.

    Raises:
        LocalError: If the system has no thread left.
    """

    def __init__(self, name: str, most: int, *, stopping: int = 0) -> None:
        self._name = name
        self._threads = _Threads(name, most, most)
        self._stopping = _Threads(f"{name} stop", math.inf, max(stopping, 1))
        self.is_used = False
        weakref.finalize(self, _close, self._threads, self._stopping).atexit = False
        try:
            self._stopping.start(stopping)
        except BaseException:
            self.close()
            raise
        _open[id(self._stopping)] = self._stopping

    def submit(self, call: Callable[[], T]) -> Future[T]:
        """Make a call in a thread.

        Raises:
            Closed: If this object was closed.
            LocalError: If the system has no thread left.
        """
        self.is_used = True
        return self._threads.submit(call)

    def stop(self, call: Callable[[], T]) -> Future[T]:
        """Make a call that stops the robot or closes something, in a separate thread for stops.

        Raises:
            Closed: If this object was closed.
            LocalError: If the system has no thread left, and no thread for stops exists yet.
        """
        self.is_used = True
        return self._stopping.submit(call, waits_for_thread=True)

    async def make(
        self, call: Callable[[], T], undo: Callable[[T], object] = lambda result: None, *, is_ordered: bool = True
    ) -> T:
        """Make a call in a thread, and wait for the result.

        Cancelling the task abandons the call, and ends the task.

        Args:
            call: The call.
            undo: Function that is called with the result, in a thread, if an abandoned call still returns a result.
            is_ordered: See `PendingCall`.

        Raises:
            Closed, LocalError: See `submit`.
        """
        pending = PendingCall(is_ordered=is_ordered)
        making = self.submit(partial(pending.make, call))
        try:
            return await self._result(making)
        except asyncio.CancelledError:
            self.give_up(pending, making, undo)
            raise
        finally:
            del making  # an error refers to this frame, and the future to the error

    async def make_stop(self, call: Callable[[], T]) -> T:
        """Make a call that stops the robot.

        If the task is cancelled, it ends at once, but the call is still made.

        Raises:
            Closed, LocalError: See `stop`.
        """
        return await self._result(self.stop(call))

    async def _result(self, making: Future[T]) -> T:
        try:
            await ended(making, asyncio.get_running_loop())
            if making.cancelled():  # it was still waiting for a thread
                raise Closed(f"{self._name} was closed")
            return making.result()
        finally:
            del making  # an error refers to this frame, and the future to the error

    def give_up(self, pending: PendingCall, making: Future[T], undo: Callable[[T], object]) -> None:
        """Abandon a submitted call: see `make`. Returns at once; idempotent."""

        def made(making: Future[T]) -> None:
            if not making.cancelled() and making.exception() is None:
                self._undo(partial(undo, making.result()))

        making.cancel()
        pending.give_up(self._undo)
        making.add_done_callback(made)

    def _undo(self, call: Callable[[], object]) -> None:
        try:
            self.stop(call)
        except (Closed, LocalError):
            # The robot was closed, so the call does not wait; or the system has no thread left, so call it here.
            call()

    def close(self) -> None:
        """Make no more calls. The threads end after their current calls. Does not wait. Idempotent."""
        _close(self._threads, self._stopping)


def _close(threads: _Threads, stopping: _Threads) -> None:
    threads.close()
    threads.drop()
    stopping.close()


#: Maximum time in s for which the end of the process waits for stops that are being sent.
_AT_EXIT = 2.0

#: Threads for the stops of all robots, by their `id`. A WeakSet cannot be copied while another thread changes it.
_open: weakref.WeakValueDictionary[int, _Threads] = weakref.WeakValueDictionary()


def _send_stops() -> None:
    """Wait until all stops are sent, because the threads end with the process.

    A task might have been cancelled just before the end.
    """
    threads = [each for each in (reference() for reference in _open.valuerefs()) if each is not None]
    for each in threads:
        each.close()
    until = clock.now() + _AT_EXIT
    for each in threads:
        each.join(clock.left(until))


atexit.register(_send_stops)
if hasattr(os, "register_at_fork"):  # not on Windows, which cannot fork
    os.register_at_fork(after_in_child=_open.clear)  # the threads do not exist there

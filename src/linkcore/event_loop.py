"""The asyncio event loop of a program: that it runs, waiting in it, what it opens, and threads for calls that wait."""

from __future__ import annotations

import asyncio
import contextlib
import math
from collections.abc import Callable, Coroutine, Generator
from concurrent.futures import Future, ThreadPoolExecutor
from functools import partial
from typing import Any, Generic, Protocol, TypeVar

from . import clock
from .attributes import StrictAttributes
from .errors import Closed, LocalError
from .pending_call import PendingCall

T = TypeVar("T")


class _Closing(Protocol):
    async def close(self) -> None: ...


C = TypeVar("C", bound=_Closing)


class Opening(StrictAttributes, Generic[C]):
    """What `connect_async` returns: ``robot = await opening``, or ``async with opening as robot``, which closes it.

    Args:
        open: connects; called once for each use.
    """

    __slots__ = ("_open", "_opened")

    def __init__(self, open: Callable[[], Coroutine[Any, Any, C]]) -> None:
        self._open = open
        self._opened: C | None = None

    def _hint(self, name: str) -> str:
        how = "'async with connect_async(...) as robot:' or 'robot = await connect_async(...)'"
        return f"; it is not connected yet, write {how}"

    def __await__(self) -> Generator[Any, None, C]:
        return self._open().__await__()

    async def __aenter__(self) -> C:
        self._opened = await self._open()
        return self._opened

    async def __aexit__(self, *exc: object) -> None:
        if self._opened is not None:
            await self._opened.close()


def running_loop(what: str) -> asyncio.AbstractEventLoop:
    """The event loop that runs in this thread.

    Raises:
        LocalError: none does; the message names `what` needs it.
    """
    try:
        return asyncio.get_running_loop()
    except RuntimeError:
        raise LocalError(
            f"{what} needs a running asyncio event loop, and none runs in this thread; "
            "from trio, curio or a plain thread, use the blocking calls, in a thread of their own"
        ) from None


async def within(seconds: float | None, future: asyncio.Future[Any]) -> bool:
    """Wait until a future is done; False when time is up; None waits for ever. It is neither cancelled nor read.

    A task that is cancelled while it waits here ends at once, also in the turn of the loop in which the future is done.
    `asyncio.wait_for` of Python 3.11 and older returns then, and the task goes on (bpo-42130).
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
    """Wait for what has to come to its end; a task that is cancelled meanwhile ends after it."""
    try:
        await asyncio.wait({ending})
    except asyncio.CancelledError:
        await asyncio.wait({ending})
        raise
    try:
        return ending.result()
    finally:
        del ending  # an error refers to this frame, and the future to the error


def happened(future: asyncio.Future[None]) -> None:
    """Have a future that stands for an event be done; idempotent, as `asyncio.Event.set` is."""
    if not future.done():
        future.set_result(None)


def ended(future: Future[Any], loop: asyncio.AbstractEventLoop) -> asyncio.Future[None]:
    """A future of `loop` that is done one turn after `future`, which any thread may end and which is left as it is.

    `asyncio.wrap_future` takes no turn of the loop from Python 3.14 on where the loop's own thread ends `future`.
    """
    end = loop.create_future()

    def end_it(_: object) -> None:
        with contextlib.suppress(RuntimeError):  # the loop is closed
            loop.call_soon_threadsafe(happened, end)

    future.add_done_callback(end_it)
    return end


class Workers:
    """Threads of one robot. The first call starts one, which stays; another is started only while all are busy.

    Args:
        name: of the threads.
        most: so many at once. What moves the arm must not stand behind what waits for an input, so not 1 where calls
            may wait long; 1 has calls follow each other.
    """

    def __init__(self, name: str, most: int) -> None:
        self._name = name
        self._threads = ThreadPoolExecutor(most, thread_name_prefix=name)
        # Of its own, and started when it is needed: what stops the robot must not stand behind calls that wait.
        self._undoing = ThreadPoolExecutor(1, thread_name_prefix=f"{name} stop")
        self.is_used = False
        self._is_closed = False

    def submit(self, call: Callable[[], T]) -> Future[T]:
        """Call in a thread.

        Raises:
            Closed: it was closed.
            LocalError: the system has no thread left.
        """
        if self._is_closed:
            raise Closed(f"{self._name} was closed")
        self.is_used = True
        try:
            return self._threads.submit(call)
        except RuntimeError as error:
            raise LocalError(f"no thread could be started: {error}") from error

    async def make(self, call: Callable[[], T], undo: Callable[[T], object] = lambda result: None) -> T:
        """Call in a thread, and wait for the result. A task that is cancelled meanwhile gives the call up and ends.

        Args:
            undo: called with the result, in a thread, where the call was given up and has one all the same.

        Raises:
            Closed, LocalError: as `submit`.
        """
        pending = PendingCall()
        making = self.submit(partial(pending.make, call))
        try:
            await ended(making, asyncio.get_running_loop())
            if making.cancelled():  # it waited for a thread
                raise Closed(f"{self._name} was closed")
            return making.result()
        except asyncio.CancelledError:
            self.give_up(pending, making, undo)
            raise
        finally:
            del making  # an error refers to this frame, and the future to the error

    def give_up(self, pending: PendingCall, making: Future[T], undo: Callable[[T], object]) -> None:
        """Give up a call that was submitted: see `make`. Returns at once; idempotent."""

        def made(making: Future[T]) -> None:
            if not making.cancelled() and making.exception() is None:
                self._undo(partial(undo, making.result()))

        making.cancel()
        pending.give_up(self._undo)
        making.add_done_callback(made)

    def _undo(self, call: Callable[[], object]) -> None:
        try:
            self._undoing.submit(call)
        except RuntimeError:  # the robot is closed, so there is nothing to wait for; or the system has no thread left
            call()

    def close(self) -> None:
        """Make no more calls; the threads end with what they do. Does not wait. Idempotent."""
        self._is_closed = True
        self._undoing.shutdown(wait=False)
        self._threads.shutdown(wait=False, cancel_futures=True)

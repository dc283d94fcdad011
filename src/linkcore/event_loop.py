"""The asyncio event loop of a program: that it runs, waiting in it with a deadline, and what is opened in it."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine, Generator
from typing import Any, Generic, Protocol, TypeVar

from .errors import LocalError

__all__ = ["Opening", "finished", "happened", "running_loop", "within"]

T = TypeVar("T")


class _Closing(Protocol):
    async def close(self) -> None: ...


C = TypeVar("C", bound=_Closing)


class Opening(Generic[C]):
    """What `connect_async` returns: ``robot = await opening``, or ``async with opening as robot``, which closes it.

    Args:
        open: connects; called once for each use.
    """

    __slots__ = ("_open", "_opened")

    def __init__(self, open: Callable[[], Coroutine[Any, Any, C]]) -> None:
        self._open = open
        self._opened: C | None = None

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
    await asyncio.wait({future}, timeout=seconds)
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

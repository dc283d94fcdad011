"""The asyncio event loop of a program: that it runs, and waiting in it with a deadline."""

from __future__ import annotations

import asyncio
from typing import Any, TypeVar

from .errors import LocalError

__all__ = ["finished", "happened", "running_loop", "within"]

T = TypeVar("T")


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


async def within(seconds: float, future: asyncio.Future[Any]) -> bool:
    """Wait until a future is done; False when time is up. It is neither cancelled nor read.

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

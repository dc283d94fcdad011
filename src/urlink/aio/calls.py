"""Commands for programs that use asyncio: each method of `robot.motion` and its like, to be awaited.

Commands go through the same interlock, channel and state machines as those of `urlink.connect`. These wait: for what
the robot says, and for what it takes. So each call is made in a thread of the robot, while the event loop, which reads
what the robot says, goes on.
"""

from __future__ import annotations

import asyncio
import contextlib
import functools
from collections.abc import Callable, Generator
from typing import Any, Generic, TypeVar

from linkcore.aio.async_stream import AsyncStream
from linkcore.aio.workers import Workers
from linkcore.errors import LinkError
from linkcore.handle import Handle
from linkcore.streaming.stream import Stream

__all__ = ["Awaited", "Call"]

T = TypeVar("T")


class Call(Generic[T]):
    """A command that has been begun: await its result.

    Of what gives a `Handle`, such as a motion, that is its end: ``await robot.motion.move_joints(q)`` goes on when the
    arm has arrived, and raises what `Handle.wait` raises. `begun` gives the handle as soon as the robot was told.

    A task that is cancelled, or runs into a timeout, while it awaits this, takes the command with it, as with
    everything that is awaited: what has not been sent is not sent, and what moves brakes. `asyncio.shield` keeps it
    from that. ``async with robot.motion.servo() as servo:`` enters a block, and leaves it whatever happens.

    Args:
        workers: make the call.
        call: is made once, at once.

    Raises:
        Closed: the robot was closed.
        LocalError: the system has no thread left.
    """

    def __init__(self, workers: Workers, call: Callable[[], T]) -> None:
        self._workers = workers
        self._submitted = workers.submit(call)
        self._begun: asyncio.Future[T] = asyncio.wrap_future(self._submitted)
        self._entered: Any = None

    async def begun(self) -> T:
        """What the call returns, as soon as it does.

        Raises:
            LinkError: as the same call of a robot of `urlink.connect`.
        """
        try:
            return await asyncio.shield(self._begun)
        except asyncio.CancelledError:
            self.cancel()
            raise

    async def _ended(self) -> T:
        try:
            value = await asyncio.shield(self._begun)
            if isinstance(value, Handle):
                await value
        except asyncio.CancelledError:
            self.cancel()
            raise
        return value

    def __await__(self) -> Generator[Any, None, T]:
        return self._ended().__await__()

    def cancel(self) -> None:
        """Give it up: what has not been begun is not, and what runs on the robot is cancelled. Returns at once."""
        self._submitted.cancel()
        self._begun.add_done_callback(self._undo)

    def _undo(self, begun: asyncio.Future[T]) -> None:
        if begun.cancelled() or begun.exception() is not None:
            return
        value = begun.result()
        if isinstance(value, Handle) and not value.done:
            with contextlib.suppress(LinkError):  # the robot is closed, which has ended it
                self._workers.submit(value.cancel)

    async def __aenter__(self) -> Any:
        value: Any = await self.begun()
        self._entered = value
        if isinstance(value, AsyncStream):
            return await value.__aenter__()
        return await _made(self._workers, value.__enter__)

    async def __aexit__(self, *exc: object) -> None:
        value = self._entered
        if isinstance(value, AsyncStream):
            await value.close()
        else:
            await _made(self._workers, functools.partial(value.__exit__, *exc))


async def _made(workers: Workers, call: Callable[[], T]) -> T:
    """A call, made to its end also where the task is cancelled meanwhile."""
    making = asyncio.wrap_future(workers.submit(call))
    try:
        return await asyncio.shield(making)
    except asyncio.CancelledError:
        await asyncio.wait({making})
        raise


class Awaited:
    """A part of a robot, such as `robot.motion`: the same names, whose methods give a `Call` each.

    What is no method is read and set as it is. Where it would have to wait, because the robot is not listened to yet,
    it raises `LocalError`; ``await robot.call(lambda: robot.safety.cause)`` waits for it.

    Args:
        part: tells the part.
        workers: make the calls.
    """

    __slots__ = ("_part", "_workers")

    def __init__(self, part: Callable[[], object], workers: Workers) -> None:
        object.__setattr__(self, "_part", part)
        object.__setattr__(self, "_workers", workers)

    def __getattr__(self, name: str) -> Any:
        found = getattr(self._part(), name)
        if not callable(found):
            return found

        @functools.wraps(found)
        def call(*arguments: Any, **options: Any) -> Call[Any]:
            return Call(self._workers, lambda: given(found(*map(taken, arguments), **options)))

        return call

    def __setattr__(self, name: str, value: object) -> None:
        setattr(self._part(), name, value)

    def __dir__(self) -> list[str]:
        return dir(self._part())

    def __repr__(self) -> str:
        return f"<Awaited {self._part()!r}>"


def given(value: Any) -> Any:
    """A result as programs that use asyncio hold it."""
    return AsyncStream(value) if isinstance(value, Stream) else value


def taken(value: Any) -> Any:
    """An argument as the library takes it."""
    return value.stream if isinstance(value, AsyncStream) else value

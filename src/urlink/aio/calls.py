"""Commands for programs that use asyncio: each method of `robot.motion` and its like returns an awaitable.

Commands use the same interlock, channel and state machines as those of `urlink.connect`, which block until the robot
has answered. So each call is made in a thread of the robot, while the event loop goes on reading the streams.
"""

from __future__ import annotations

import asyncio
import functools
from collections.abc import Callable, Generator
from typing import Any, Generic, TypeVar

from linkcore.aio.async_stream import AsyncStream
from linkcore.aio.workers import Workers
from linkcore.event_loop import finished, running_loop
from linkcore.handle import Handle
from linkcore.pending_call import PendingCall
from linkcore.recording.recorder import Recorder
from linkcore.streaming.stream import Stream

__all__ = ["Awaited", "Call"]

T = TypeVar("T")


class Call(Generic[T]):
    """A command that has been started: await its result.

    If the command returns a `Handle`, as a motion does, the result is its end: ``await robot.motion.move_joints(q)``
    returns when the arm has arrived, and raises what `Handle.wait` raises. `begun` returns the handle as soon as the
    command is sent.

    If a task is cancelled, or times out, while it awaits this, the command is cancelled as well: what has not been sent
    is not sent, and a motion brakes. `asyncio.shield` prevents this. ``async with robot.motion.servo() as servo:``
    enters a block, and always leaves it.

    Args:
        workers: the threads that make the calls.
        call: called once, at once.

    Raises:
        Closed: the robot was closed.
        LocalError: the system has no thread left.
    """

    def __init__(self, workers: Workers, call: Callable[[], T]) -> None:
        loop = running_loop("a command of a robot of connect_async")
        self._workers = workers
        self._pending = PendingCall()
        self._submitted = workers.submit(functools.partial(self._pending.make, call))
        self._begun: asyncio.Future[T] = asyncio.wrap_future(self._submitted, loop=loop)
        self._entered: Any = None

    async def begun(self) -> T:
        """What the call returns, as soon as it returns.

        Raises:
            LinkError: as the same call of a robot of `urlink.connect`.
        """
        try:
            return await asyncio.shield(self._begun)
        except asyncio.CancelledError:
            self.cancel()
            raise
        finally:
            del self  # an error refers to this frame, and the future of the call to the error

    async def _ended(self) -> T:
        value: Any = None
        try:
            value = await asyncio.shield(self._begun)
            if isinstance(value, Handle):
                await asyncio.wrap_future(value._life.future)  # and not `value`, which would brake in this thread
            result: T = value
            return result
        except asyncio.CancelledError:
            self.cancel()
            raise
        finally:
            del self, value  # as in `begun`

    def __await__(self) -> Generator[Any, None, T]:
        return self._ended().__await__()

    def cancel(self) -> None:
        """Cancel: a call that has not sent anything sends nothing, and what runs on the robot is cancelled.

        Returns at once; idempotent. A call that waits goes on waiting in its thread, to its own timeout.
        """
        self._workers.give_up(self._pending, self._submitted, _end)
        self._begun.add_done_callback(_read)

    async def __aenter__(self) -> Any:
        value: Any = await self.begun()
        self._entered = value
        if isinstance(value, AsyncStream):
            return await value.__aenter__()
        try:
            return await self._workers.make(value.__enter__, lambda entered: value.__exit__(None, None, None))
        except asyncio.CancelledError:
            self.cancel()
            raise

    async def __aexit__(self, *exc: object) -> None:
        value = self._entered
        if isinstance(value, AsyncStream):
            await value.close()
        else:
            await finished(asyncio.wrap_future(self._workers.submit(functools.partial(value.__exit__, *exc))))


def _end(value: Any) -> None:
    """End what a call has made that was given up."""
    if isinstance(value, Handle):
        value.cancel()
    elif isinstance(value, AsyncStream):
        value.stream.close()
    elif isinstance(value, Recorder):
        value.close()


def _read(begun: asyncio.Future[Any]) -> None:
    """asyncio would log an error that nobody reads."""
    if not begun.cancelled():
        begun.exception()


class Awaited:
    """A part of a robot, such as `robot.motion`: the same names, but each method returns a `Call`.

    Attributes that are not methods are read and set directly. One that would have to wait, because its stream is not
    open yet, raises `LocalError`; ``await robot.call(lambda: robot.safety.cause)`` waits for it.

    Args:
        part: returns the part.
        workers: the threads that make the calls.
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
    """A result of the library, converted for programs that use asyncio."""
    return AsyncStream(value) if isinstance(value, Stream) else value


def taken(value: Any) -> Any:
    """An argument, converted for the library."""
    return value.stream if isinstance(value, AsyncStream) else value

"""Conversion of blocking methods to awaitable methods with the same name, arguments, result and types.

Commands use the same interlock, channel and state machines as a robot of `urlink.connect`. These commands block until
the robot has answered. Therefore each call runs in a thread of the robot, and the event loop continues to read the
streams and RTDE connections.
"""

from __future__ import annotations

import asyncio
import functools
from collections.abc import Callable, Coroutine, Generator
from contextlib import AbstractContextManager
from typing import TYPE_CHECKING, Any, Concatenate, Generic, ParamSpec, TypeVar, overload

from linkcore import clock
from linkcore.clock import Stamp
from linkcore.errors import BadValue, LinkTimeout
from linkcore.event_loop import Workers, ended, running_loop
from linkcore.handle import Handle
from linkcore.names import StrictAttributes
from linkcore.net.awaited import AwaitedTcp

from ..protocol.rtde.protocol import Requests
from ..protocol.rtde.transport import RtdeDialogue, RtdeTransport

if TYPE_CHECKING:
    from typing_extensions import Self

B = TypeVar("B")
C = TypeVar("C", bound=AbstractContextManager[Any])
H = TypeVar("H", bound=Handle)
P = ParamSpec("P")
T = TypeVar("T")


class AwaitedPart(StrictAttributes, Generic[B]):
    """Robot, or a part of a robot such as `robot.motion`, with awaitable methods.

    Attributes are read immediately. If an attribute needs a stream that is not open yet, reading it raises
    `LocalError`. To wait for such an attribute, use `call`: ``await robot.call(lambda: robot.safety.cause)``.

    Args:
        part: Blocking version of this part, from a robot of `urlink.connect`.
        workers: Threads that run the calls.
    """

    __slots__ = ("_part", "_workers")

    def __init__(self, part: B, workers: Workers) -> None:
        self._part = part
        self._workers = workers

    def __repr__(self) -> str:
        return f"<{type(self).__name__} of {self._part!r}>"


class attribute(property, Generic[B, T]):  # noqa: N801  # as `property`
    """Attribute of an `AwaitedPart` that is read immediately.

    Args:
        of: Class of the blocking part, which is passed to `read`.
        read: Function that returns the value of the attribute for a part.
    """

    def __init__(self, of: type[B], read: Callable[[B], T]) -> None:
        super().__init__(lambda part: read(part._part))

    if TYPE_CHECKING:

        @overload
        def __get__(self, part: None, owner: type, /) -> Self: ...
        @overload
        def __get__(self, part: Any, owner: type | None = None, /) -> T: ...
        def __get__(self, part: Any, owner: type | None = None, /) -> Any: ...


class AwaitedHandle(AwaitedPart[H]):
    """Part that is a handle; ``await`` waits for the end of its motion or program, as for any handle."""

    __slots__ = ()

    name = attribute(Handle, lambda handle: handle.name)
    phase = attribute(Handle, lambda handle: handle.phase)
    done = attribute(Handle, lambda handle: handle.done)
    error = attribute(Handle, lambda handle: handle.error)

    def cancel(self) -> None:
        """Cancel the motion or program like `Handle.cancel`, and return immediately."""
        self._part.cancel()

    def add_done_callback(self, callback: Callable[[Self], object]) -> None:
        """Add a callback like `Handle.add_done_callback`. The callback runs in the robot's callback thread."""
        self._part.add_done_callback(lambda handle: callback(self))

    def __await__(self) -> Generator[Any, None, None]:
        return self._part.__await__()


def awaited(method: Callable[Concatenate[Any, P], T]) -> Callable[Concatenate[Any, P], Coroutine[Any, Any, T]]:
    """Return the method of an `AwaitedPart` that runs a call in a thread of the robot.

    If a task is cancelled while it awaits the method, the call is abandoned: pending data is not sent, a motion or
    program that the call started is cancelled, and the thread of the call stops waiting.
    """

    @functools.wraps(method)
    async def call(part: AwaitedPart[Any], /, *arguments: P.args, **options: P.kwargs) -> T:
        running_loop("a command of a robot of connect_async")
        return await part._workers.make(lambda: method(part._part, *arguments, **options), _end)

    return call


def stopping(method: Callable[Concatenate[Any, P], T]) -> Callable[Concatenate[Any, P], Coroutine[Any, Any, T]]:
    """Like `awaited`, for a call that stops or closes something. Such a call never queues behind a waiting call.

    The call runs even if its task is cancelled in the meantime; the task ends immediately.
    """

    @functools.wraps(method)
    async def call(part: AwaitedPart[Any], /, *arguments: P.args, **options: P.kwargs) -> T:
        running_loop("a command of a robot of connect_async")
        return await part._workers.make_stop(lambda: method(part._part, *arguments, **options))

    return call


def motion(method: Callable[Concatenate[Any, P], T]) -> Callable[Concatenate[Any, P], Coroutine[Any, Any, T]]:
    """Like `awaited`, for a call that starts a motion and returns its handle. The argument `wait` is required.

    A reader might expect that `await` before such a call waits for the arm. But without `wait`, the program would
    continue immediately while the arm moves. Therefore a call without `wait` is rejected.
    """
    call = awaited(method)

    @functools.wraps(method)
    async def decided(part: AwaitedPart[Any], /, *arguments: P.args, **options: P.kwargs) -> T:
        if "wait" not in options:
            raise BadValue(
                f"{method.__name__}() was awaited without `wait`, so nothing was sent; pass wait=True to wait until "
                "the arm has arrived, or wait=False to get the handle after sending, which can be awaited"
            )
        return await call(part, *arguments, **options)

    return decided


class Block(StrictAttributes, Generic[T]):
    """Block such as ``async with robot.motion.servo() as servo``. A thread of the robot enters and leaves it.

    You can also await the block instead of entering it. The result is then the object that the blocking call returns
    without a ``with`` statement.

    Args:
        workers: Threads of the robot.
        make: Call that returns the context manager.
        given: Function that converts the entered or awaited object to its version for asyncio.
    """

    __slots__ = ("_entered", "_given", "_make", "_workers")

    def __init__(self, workers: Workers, make: Callable[[], C], given: Callable[[C, Workers], T]) -> None:
        self._workers = workers
        self._make: Callable[[], Any] = make
        self._given: Callable[[Any, Workers], T] = given
        self._entered: Any = None

    def _hint(self, name: str) -> str:
        return f"; the block is not entered yet: write 'async with ... as block:' and then block.{name}"

    def __await__(self) -> Generator[Any, None, T]:
        return self._made().__await__()

    async def _made(self) -> T:
        running_loop("a command of a robot of connect_async")
        return self._given(await self._workers.make(self._make, _end), self._workers)

    async def __aenter__(self) -> T:
        def enter() -> Any:
            made = self._make()
            made.__enter__()
            return made

        running_loop("a block of a robot of connect_async")
        self._entered = await self._workers.make(enter, _leave)
        return self._given(self._entered, self._workers)

    async def __aexit__(self, *exc: object) -> None:
        left = self._workers.stop(functools.partial(self._entered.__exit__, *exc))
        leaving = ended(left, asyncio.get_running_loop())
        try:
            await asyncio.wait({leaving})
        except asyncio.CancelledError:
            if isinstance(self._entered, Handle):  # leaving a handle waits for its program, without a time limit
                self._workers.stop(self._entered.cancel)
            await asyncio.wait({leaving})
            raise
        try:
            left.result()
        finally:
            del left  # breaks a reference cycle: the future holds the error, and the error holds this frame


@overload
def block(method: Callable[Concatenate[Any, P], C]) -> Callable[Concatenate[Any, P], Block[C]]: ...
@overload
def block(
    method: Callable[Concatenate[Any, P], C], given: Callable[[C, Workers], T]
) -> Callable[Concatenate[Any, P], Block[T]]: ...
def block(method: Callable[..., Any], given: Callable[..., Any] = lambda made, workers: made) -> Any:
    """Return a method of an `AwaitedPart` that returns a `Block`, which is entered with ``async with``."""

    @functools.wraps(method)
    def call(part: AwaitedPart[Any], /, *arguments: Any, **options: Any) -> Block[Any]:
        return Block(part._workers, lambda: method(part._part, *arguments, **options), given)

    return call


def _leave(made: AbstractContextManager[Any]) -> None:
    made.__exit__(asyncio.CancelledError, None, None)


def _end(value: Any) -> None:
    """End or close the object that an abandoned call has returned."""
    if isinstance(value, Handle):
        _leave(value)
    elif hasattr(value, "close"):  # such as a stream, a recorder or RTDE inputs
        value.close()


class AwaitedRtde(RtdeTransport):
    """RTDE connection for an event loop, as an `RtdeTransport`.

    Args:
        transport: TCP connection.
        plan: Requests to send.
    """

    def __init__(self, transport: AwaitedTcp, plan: Requests) -> None:
        super().__init__(transport, plan)
        self._tcp = transport
        self.fileno = transport.fileno
        self.disconnect = transport.disconnect

    async def connect(self, timeout: float) -> None:
        """Connect, send the requests of the plan, and wait for the first data package; see `RtdeTransport.open`."""
        until = clock.now() + timeout
        await self._tcp.connect(timeout)
        dialogue = RtdeDialogue(self._plan)
        try:
            while not dialogue.is_over:
                # The requests are the first bytes on the connection, so the send buffer of the kernel has space for
                # them.
                self._tcp.send(dialogue.protocol.requests(), 0.0)
                try:
                    dialogue.receive(*await self._tcp.receive_awaited(max(until - clock.now(), 0.001)))
                except LinkTimeout:
                    raise dialogue.unanswered(self.name, timeout) from None
                if clock.now() > until and not dialogue.protocol.is_ready:
                    raise dialogue.unanswered(self.name, timeout)
        except BaseException:
            self._tcp.abort()
            raise
        self._begin(dialogue)

    def receive_waiting(self) -> tuple[bytes, Stamp] | None:
        """See `AwaitedTransport.receive_waiting`."""
        return self._first.popleft() if self._first else self._tcp.receive_waiting()

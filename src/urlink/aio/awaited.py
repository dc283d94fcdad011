"""How a method that blocks becomes one that is awaited: same name, same arguments, same result, and their types.

Commands use the same interlock, channel and state machines as those of `urlink.connect`, which block until the robot
has answered. So each call is made in a thread of the robot, while the event loop goes on reading the streams, an RTDE
connection among them.
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
    """A robot, or a part of one such as `robot.motion`, with methods that are awaited.

    An attribute that is not a method is read at once. One that would have to wait, because its stream is not open yet,
    raises `LocalError`; ``await robot.call(lambda: robot.safety.cause)`` waits for it.

    Args:
        part: the same of a robot of `urlink.connect`.
        workers: the threads that make the calls.
    """

    __slots__ = ("_part", "_workers")

    def __init__(self, part: B, workers: Workers) -> None:
        self._part = part
        self._workers = workers

    def __repr__(self) -> str:
        return f"<{type(self).__name__} of {self._part!r}>"


class attribute(property, Generic[B, T]):  # noqa: N801  # as `property`
    """An attribute of an `AwaitedPart` that is read at once.

    Args:
        of: class of the part, for the type of what `read` is given.
        read: takes the value from the part.
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
    """A part that is a handle; ``await`` of it is the end of what runs, as of any handle."""

    __slots__ = ()

    name = attribute(Handle, lambda handle: handle.name)
    phase = attribute(Handle, lambda handle: handle.phase)
    done = attribute(Handle, lambda handle: handle.done)
    error = attribute(Handle, lambda handle: handle.error)

    def cancel(self) -> None:
        """As `Handle.cancel`, which returns at once."""
        self._part.cancel()

    def add_done_callback(self, callback: Callable[[Self], object]) -> None:
        """As `Handle.add_done_callback`: in the robot's thread for callbacks."""
        self._part.add_done_callback(lambda handle: callback(self))

    def __await__(self) -> Generator[Any, None, None]:
        return self._part.__await__()


def awaited(method: Callable[Concatenate[Any, P], T]) -> Callable[Concatenate[Any, P], Coroutine[Any, Any, T]]:
    """The method of a `AwaitedPart` that makes this call in a thread of the robot.

    A task that is cancelled while it awaits this abandons the call: what has not been sent is not sent, what the call
    has started on the robot is cancelled, and a wait in its thread ends.
    """

    @functools.wraps(method)
    async def call(part: AwaitedPart[Any], /, *arguments: P.args, **options: P.kwargs) -> T:
        running_loop("a command of a robot of connect_async")
        return await part._workers.make(lambda: method(part._part, *arguments, **options), _end)

    return call


def stopping(method: Callable[Concatenate[Any, P], T]) -> Callable[Concatenate[Any, P], Coroutine[Any, Any, T]]:
    """As `awaited`, for a call that stops or closes something: it never queues behind a call that waits.

    It is made even if its task is cancelled meanwhile; the task ends at once.
    """

    @functools.wraps(method)
    async def call(part: AwaitedPart[Any], /, *arguments: P.args, **options: P.kwargs) -> T:
        running_loop("a command of a robot of connect_async")
        return await part._workers.make_stop(lambda: method(part._part, *arguments, **options))

    return call


def motion(method: Callable[Concatenate[Any, P], T]) -> Callable[Concatenate[Any, P], Coroutine[Any, Any, T]]:
    """As `awaited`, for what begins to move the arm and returns its handle: `wait` has to be given.

    `await` before such a name reads as if it waited for the arm, and did so in the first releases. Without `wait` it
    would now go on at once, while the arm moves; so that is refused.
    """
    call = awaited(method)

    @functools.wraps(method)
    async def decided(part: AwaitedPart[Any], /, *arguments: P.args, **options: P.kwargs) -> T:
        if "wait" not in options:
            raise BadValue(
                f"{method.__name__}() was awaited without `wait`; nothing was sent. Pass wait=True to go on once the "
                "arm has arrived, or wait=False to go on once it was sent, with its handle, which can be awaited"
            )
        return await call(part, *arguments, **options)

    return decided


class Block(StrictAttributes, Generic[T]):
    """``async with robot.motion.servo() as servo``: entered and always left in a thread of the robot; or awaited.

    Awaited, it is what the same call of `urlink.connect` returns without a ``with``.

    Args:
        workers: the threads.
        make: the call that returns what can be entered.
        given: converts that for programs that use asyncio.
    """

    __slots__ = ("_entered", "_given", "_make", "_workers")

    def __init__(self, workers: Workers, make: Callable[[], C], given: Callable[[C, Workers], T]) -> None:
        self._workers = workers
        self._make: Callable[[], Any] = make
        self._given: Callable[[Any, Workers], T] = given
        self._entered: Any = None

    def _hint(self, name: str) -> str:
        return f"; it is not entered yet, write 'async with ... as block:' and then block.{name}"

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
            if isinstance(self._entered, Handle):  # it waits for its program, for as long as that takes
                self._workers.stop(self._entered.cancel)
            await asyncio.wait({leaving})
            raise
        try:
            left.result()
        finally:
            del left  # an error refers to this frame, and the future to the error


@overload
def block(method: Callable[Concatenate[Any, P], C]) -> Callable[Concatenate[Any, P], Block[C]]: ...
@overload
def block(
    method: Callable[Concatenate[Any, P], C], given: Callable[[C, Workers], T]
) -> Callable[Concatenate[Any, P], Block[T]]: ...
def block(method: Callable[..., Any], given: Callable[..., Any] = lambda made, workers: made) -> Any:
    """The method of a `AwaitedPart` whose result is entered with ``async with``."""

    @functools.wraps(method)
    def call(part: AwaitedPart[Any], /, *arguments: Any, **options: Any) -> Block[Any]:
        return Block(part._workers, lambda: method(part._part, *arguments, **options), given)

    return call


def _leave(made: AbstractContextManager[Any]) -> None:
    made.__exit__(asyncio.CancelledError, None, None)


def _end(value: Any) -> None:
    """End what a call has made that was given up."""
    if isinstance(value, Handle):
        _leave(value)
    elif hasattr(value, "close"):  # a stream, a recorder, inputs
        value.close()


class AwaitedRtde(RtdeTransport):
    """As `RtdeTransport`, for an event loop.

    Args:
        transport: the TCP connection.
        plan: what to request.
    """

    def __init__(self, transport: AwaitedTcp, plan: Requests) -> None:
        super().__init__(transport, plan)
        self._tcp = transport
        self.fileno = transport.fileno
        self.disconnect = transport.disconnect

    async def connect(self, timeout: float) -> None:
        """Connect, request what the plan says, and wait for the first data package; see `RtdeTransport.open`."""
        until = clock.now() + timeout
        await self._tcp.connect(timeout)
        dialogue = RtdeDialogue(self._plan)
        try:
            while not dialogue.is_over:
                # The first bytes on a connection: the buffer of the kernel has room for them.
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

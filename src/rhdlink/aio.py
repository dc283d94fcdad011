"""A robot for programs that use asyncio: what waits for the robot is awaited, everything else stays as it is.

    async with rhdlink.connect_async("smr12", rhdlink.Smr, access="w") as robot:
        robot.variables.speedl = 20
        await robot.sync()
        print(robot.variables.encl)

Reading and setting variables never waits, so it is done on the robot itself. `sync` runs in a thread that belongs to
the robot: RHD answers questions, and a question waits for its answer. Missions and motions need nothing of this: their
handles can be awaited.
"""

from __future__ import annotations

import asyncio
import functools
from collections.abc import AsyncIterator, Generator
from typing import TYPE_CHECKING, Any, Generic, TypeVar, overload

from linkcore.aio.workers import Workers
from linkcore.errors import Closed
from linkcore.event_loop import finished, running_loop

from .client import Variables
from .client import connect as connect_here

if TYPE_CHECKING:
    from typing_extensions import Self

__all__ = ["AsyncRobot", "connect", "connect_async"]

R = TypeVar("R", bound=Variables)


class AsyncRobot(Generic[R]):
    """A connected robot. An asynchronous context manager that closes itself. Made by `connect_async`.

    Attributes:
        variables: the robot itself, with its properties. They change with `sync` and only with it.
    """

    def __init__(self, variables: R, thread: Workers) -> None:
        self.variables = variables
        self._thread = thread
        self._is_closed = False

    async def sync(self, timeout: float | None = None) -> None:
        """As `Variables.sync`. Several at once wait for each other.

        Cancelled before it is sent, it is not sent. After that the exchange goes on to its answer or its deadline; the
        next sync comes after it.

        Raises:
            as `Variables.sync`.
        """
        if self._is_closed:
            raise Closed(f"{self.variables.address} was closed")
        await self._thread.make(functools.partial(self.variables.sync, timeout))

    async def updates(self, timeout: float | None = None) -> AsyncIterator[R]:
        """Sync again and again, and give the robot after each answer, until the loop is left.

        Raises:
            as `Variables.sync`. The next loop goes on, and connects again where the connection was lost.
        """
        while True:
            await self.sync(timeout)
            yield self.variables

    async def close(self) -> None:
        """Close the connection. Idempotent."""
        self._is_closed = True
        # Not in the robot's own thread, which may be in a sync that this is to end.
        closing = asyncio.get_running_loop().run_in_executor(None, self.variables.close)
        try:
            await finished(closing)
        finally:
            self._thread.close()

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, *exc: object) -> None:
        await self.close()

    def __repr__(self) -> str:
        return f"<{type(self).__name__} of {self.variables!r}>"


class _Connecting(Generic[R]):
    """The result of `connect_async`: to be awaited, or entered by ``async with``."""

    def __init__(self, address: str, variables: type[R], options: dict[str, Any]) -> None:
        self._arguments = address, variables, options
        self._robot: AsyncRobot[R] | None = None

    async def _connect(self) -> AsyncRobot[R]:
        address, variables, options = self._arguments
        running_loop("connect_async")
        thread = Workers(f"rhdlink {address}", 1)
        try:
            robot = await thread.make(lambda: connect_here(address, variables, **options), Variables.close)
        except BaseException:
            thread.close()
            raise
        return AsyncRobot(robot, thread)

    def __await__(self) -> Generator[Any, None, AsyncRobot[R]]:
        return self._connect().__await__()

    async def __aenter__(self) -> AsyncRobot[R]:
        self._robot = await self._connect()
        return self._robot

    async def __aexit__(self, *exc: object) -> None:
        if self._robot is not None:
            await self._robot.close()


@overload
def connect_async(address: str, **options: Any) -> _Connecting[Variables]: ...


@overload
def connect_async(address: str, variables: type[R], **options: Any) -> _Connecting[R]: ...


def connect_async(address: str, variables: type[Variables] = Variables, **options: Any) -> _Connecting[Any]:
    """Connect to a robot, to be entered or awaited.

    ``async with rhdlink.connect_async(...) as robot``, or ``robot = await rhdlink.connect_async(...)``.

    Args:
        address: as for `rhdlink.connect`.
        variables: the class that declares what the program uses.
        options: the other arguments of `rhdlink.connect`.

    Raises:
        as `rhdlink.connect`, when it is awaited or entered.
    """
    return _Connecting(address, variables, options)


#: The name that it had first.
connect = connect_async

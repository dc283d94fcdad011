"""A robot for programs that use asyncio: what waits for the robot is awaited, everything else stays as it is.

    async with rhdlink.connect_async("smr12", rhdlink.robots.Smr, access="w") as robot:
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
import inspect
import os
from collections.abc import AsyncIterator
from typing import TYPE_CHECKING, Any, Generic, Literal, TypedDict

from linkcore.errors import Closed
from linkcore.event_loop import Opening, Workers, finished, running_loop
from linkcore.names import StrictAttributes

from .client import Access, R, Variables
from .client import connect as connect_here

if TYPE_CHECKING:
    from typing_extensions import Self, Unpack

    from .replica import Unsent
    from .wire.decoder import Limits


class AsyncRobot(StrictAttributes, Generic[R]):
    """A connected robot. An asynchronous context manager that closes itself. Made by `connect_async`.

    Attributes:
        variables: the robot itself, with its properties. They change with `sync` and only with it.
    """

    __slots__ = ("_ending", "_is_closed", "_thread", "variables")

    def __init__(self, variables: R, thread: Workers) -> None:
        self.variables = variables
        self._thread = thread
        self._is_closed = False
        self._ending: asyncio.Task[None] | None = None

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

    async def close(self, timeout: float = 2.0) -> None:
        """Close the connection, within `timeout` seconds; see `Variables.close`. Idempotent.

        A task that is cancelled meanwhile ends when this is done.
        """
        self._is_closed = True
        if self._ending is None:
            self._ending = asyncio.create_task(self._close(timeout))
        await finished(self._ending)

    async def _close(self, timeout: float) -> None:
        try:
            # Not in the robot's own thread, which may be in a sync that this is to end.
            await self._thread.make_stop(lambda: self.variables.close(timeout))
        finally:
            self._thread.close()

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, *exc: object) -> None:
        await self.close()

    def __repr__(self) -> str:
        return f"<{type(self).__name__} of {self.variables!r}>"


class _Options(TypedDict, total=False):
    """The arguments of `rhdlink.connect` beside the address and the class; see there."""

    access: Access
    fallback: Literal["r"] | None
    timeout: float
    unsent: Unsent
    width: int | None
    limits: Limits | None
    record: str | os.PathLike[str] | None


def connect_async(
    address: str, variables: type[R] | None = None, **options: Unpack[_Options]
) -> Opening[AsyncRobot[R]]:
    """Connect to a robot, to be entered or awaited.

    ``async with rhdlink.connect_async(...) as robot``, or ``robot = await rhdlink.connect_async(...)``.

    Args:
        address: as for `rhdlink.connect`.
        variables: the class that declares what the program uses.
        options: the other arguments of `rhdlink.connect`.

    Raises:
        TypeError: at once, for an argument that `rhdlink.connect` does not have.
        as `rhdlink.connect`, when it is awaited or entered.
    """
    inspect.signature(connect_here).bind(address, variables, **options)
    return Opening(functools.partial(_connected, address, variables, options))


async def _connected(address: str, variables: Any, options: _Options) -> AsyncRobot[Any]:
    running_loop("connect_async")
    thread = Workers(f"rhdlink {address}", 1, stopping=1)
    try:
        robot = await thread.make(lambda: connect_here(address, variables, **options), Variables.close)
    except BaseException:
        thread.close()
        raise
    return AsyncRobot(robot, thread)


#: The name that it had first.
connect = connect_async

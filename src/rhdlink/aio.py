"""Robot objects for programs that use asyncio. Only calls that wait for the robot are coroutines.

    async with rhdlink.connect_async("smr12", rhdlink.robots.Smr, access="w") as robot:
        robot.variables.speedl = 20
        await robot.sync()
        print(robot.variables.encl)

Reading and setting variables never waits, so a program reads and sets them directly on the robot object. `sync` runs in
a dedicated thread of the robot, because RHD answers requests and each request waits for its answer. Missions and
motions do not need this module, because their handles can be awaited.
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

    from .sync.replica import Unsent
    from .wire.decoder import Limits


class AsyncRobot(StrictAttributes, Generic[R]):
    """Connected robot for asyncio, created by `connect_async`. It is an async context manager.

    Attributes:
        variables: Robot object with the declared properties. Their values change only with `sync`.
    """

    __slots__ = ("_ending", "_is_closed", "_thread", "variables")

    def __init__(self, variables: R, thread: Workers) -> None:
        self.variables = variables
        self._thread = thread
        self._is_closed = False
        self._ending: asyncio.Task[None] | None = None

    async def sync(self, timeout: float | None = None) -> None:
        """Exchange values with the robot; see `Variables.sync`.

        Concurrent calls wait for each other.

        If the call is cancelled before the request is sent, nothing is sent. After that, the exchange continues until
        the answer or its deadline; the next sync starts after it.

        Raises:
            LinkError: If the sync fails; see `Variables.sync`.
        """
        if self._is_closed:
            raise Closed(f"{self.variables.address} was closed")
        await self._thread.make(functools.partial(self.variables.sync, timeout))

    async def updates(self, timeout: float | None = None) -> AsyncIterator[R]:
        """Sync repeatedly, and yield the robot after each answer, until the loop ends.

        Raises:
            LinkError: If a sync fails; see `Variables.sync`. The next loop continues, and reconnects if the connection
                was lost.
        """
        while True:
            await self.sync(timeout)
            yield self.variables

    async def close(self, timeout: float = 2.0) -> None:
        """Close the connection within `timeout` seconds; see `Variables.close`. Idempotent.

        If the awaiting task is cancelled, it ends only after the connection is closed.
        """
        self._is_closed = True
        if self._ending is None:
            self._ending = asyncio.create_task(self._close(timeout))
        await finished(self._ending)

    async def _close(self, timeout: float) -> None:
        try:
            # Do not use the robot's own thread, which might be in the sync that this call ends.
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
    """Arguments of `rhdlink.connect`, except the address and the class."""

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
    """Connect to a robot. Await the result, or enter it with `async with`.

    ``async with rhdlink.connect_async(...) as robot``, or ``robot = await rhdlink.connect_async(...)``.

    Args:
        address: Address of the robot; see `rhdlink.connect`.
        variables: Class that declares the variables of your program.
        options: Other arguments of `rhdlink.connect`.

    Raises:
        TypeError: If an argument is not one of `rhdlink.connect`. Raised immediately.
        LinkError: If connecting fails, when the result is awaited or entered; see `rhdlink.connect`.
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


#: Former name of `connect_async`.
connect = connect_async

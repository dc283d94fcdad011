"""Arms that move together, for programs that use asyncio."""

from __future__ import annotations

from collections.abc import AsyncIterator, Callable, Generator
from typing import Any

from linkcore.errors import BadValue
from linkcore.handle import Phase
from linkcore.streaming.packet_queue import drop_oldest, latest

from ..group import WAITING, Group, GroupStream
from ..interfaces.realtime.packets import RealtimeState
from ..motion import PointStream
from .async_robot import AsyncRobot
from .awaited import AwaitedPart, awaited, block, motion

__all__ = ["AsyncGroup", "AsyncGroupStream"]


class AsyncGroupStream(AwaitedPart[GroupStream]):
    """As `GroupStream`, awaited; ``await stream`` is its end, as of any handle.

    A task that is cancelled while it awaits `append` gives its points up: those that were not sent are dropped.
    """

    __slots__ = ()

    append = awaited(GroupStream.append)
    wait = awaited(GroupStream.wait)
    wait_until_dry = awaited(GroupStream.wait_until_dry)

    @property
    def motions(self) -> tuple[PointStream, ...]:
        return self._part.motions

    @property
    def time(self) -> float:
        return self._part.time

    @property
    def end(self) -> float:
        return self._part.end

    @property
    def buffered(self) -> float:
        return self._part.buffered

    @property
    def room(self) -> float:
        return self._part.room

    @property
    def is_dry(self) -> bool:
        return self._part.is_dry

    @property
    def starved(self) -> int:
        return self._part.starved

    @property
    def name(self) -> str:
        return self._part.name

    @property
    def phase(self) -> Phase:
        return self._part.phase

    @property
    def done(self) -> bool:
        return self._part.done

    @property
    def error(self) -> Exception | None:
        return self._part.error

    @property
    def progress(self) -> float:
        return self._part.progress

    def cancel(self) -> None:
        """As `Handle.cancel`, which returns at once."""
        self._part.cancel()

    def add_done_callback(self, callback: Callable[[AsyncGroupStream], object]) -> None:
        """As `Handle.add_done_callback`: in the group's thread for callbacks."""
        self._part.add_done_callback(lambda handle: callback(self))

    def __await__(self) -> Generator[Any, None, None]:
        return self._part.__await__()


class AsyncGroup(AwaitedPart[Group]):
    """As `urlink.Group`, awaited::

        async with urlink.connect_async(LEFT) as left, urlink.connect_async(RIGHT) as right:
            both = AsyncGroup(left, right)
            await both.follow([reach_left, reach_right], wait=True)

    Calls are made in threads of the first robot.

    Args:
        robots: at least two, each once, and each with a state: ``await robot.realtime.wait()``.

    Attributes:
        robots: as given.

    Raises:
        BadValue: fewer than two, or one of them twice.
    """

    __slots__ = ("robots",)

    def __init__(self, *robots: AsyncRobot) -> None:
        for robot in robots:
            if not isinstance(robot, AsyncRobot):
                raise BadValue(f"{robot!r} is no AsyncRobot of urlink.connect_async")
        group = Group(*(robot._part for robot in robots))
        super().__init__(group, robots[0]._workers)
        self.robots = robots

    follow = motion(Group.follow)
    move_joints = motion(Group.move_joints)
    stop = awaited(Group.stop)
    stream = block(Group.stream, AsyncGroupStream)

    async def states(self, timeout: float | None = 5.0) -> AsyncIterator[tuple[RealtimeState, ...]]:
        """As `Group.states`: ``async for left, right in both.states()``."""
        first, nearest = self._part._nearest()
        others = {each: self.robots[each].realtime.iterate(drop_oldest(WAITING), timeout) for each in nearest}
        to_local = self.robots[first].clock.to_local
        async for state in self.robots[first].realtime.iterate(latest, timeout):
            local, found = to_local(state.time), {first: state}
            for number, near in nearest.items():
                while near.is_before(local):
                    newer = await anext(others[number], None)
                    if newer is None:
                        return
                    near.take(newer)
                near.add_to(found, number, local)
            if len(found) == len(self.robots):
                yield tuple(found[number] for number in range(len(found)))

"""Groups of arms that move together, for programs that use asyncio."""

from __future__ import annotations

from collections.abc import AsyncIterator

from linkcore.errors import BadValue
from linkcore.streaming.packet_queue import drop_oldest, latest

from ..group import WAITING, Group
from ..motion.stream.group_motion import GroupStream
from ..protocol.realtime.packets import RealtimeState
from .async_robot import AsyncRobot
from .awaited import AwaitedHandle, AwaitedPart, attribute, awaited, block, motion, stopping

__all__ = ["AsyncGroup", "AsyncGroupStream"]


class AsyncGroupStream(AwaitedHandle[GroupStream]):
    """Awaitable version of `GroupStream`; ``await stream`` waits for the end of the stream, as for any handle.

    If a task is cancelled while it awaits `append`, the points that are not sent yet are dropped.
    """

    __slots__ = ()

    append = awaited(GroupStream.append)
    clear = stopping(GroupStream.clear)
    replace = awaited(GroupStream.replace)
    wait = awaited(GroupStream.wait)
    wait_until_dry = awaited(GroupStream.wait_until_dry)

    motions = attribute(GroupStream, lambda part: part.motions)
    time = attribute(GroupStream, lambda part: part.time)
    end = attribute(GroupStream, lambda part: part.end)
    buffered = attribute(GroupStream, lambda part: part.buffered)
    room = attribute(GroupStream, lambda part: part.room)
    is_dry = attribute(GroupStream, lambda part: part.is_dry)
    starved = attribute(GroupStream, lambda part: part.starved)
    progress = attribute(GroupStream, lambda part: part.progress)


class AsyncGroup(AwaitedPart[Group]):
    """Awaitable version of `urlink.Group`::

        async with urlink.connect_async(LEFT) as left, urlink.connect_async(RIGHT) as right:
            both = AsyncGroup(left, right)
            await both.follow([reach_left, reach_right], wait=True)

    Calls of the group run in threads of the first robot.

    Args:
        robots: Robots of the group: at least two, each only once. A real-time state of each robot must have arrived, so
            call ``await robot.realtime.wait()`` first.

    Attributes:
        robots: Robots of the group, in the order of the arguments.

    Raises:
        BadValue: If there are fewer than two robots, or a robot is given twice.
    """

    __slots__ = ("robots",)

    def __init__(self, *robots: AsyncRobot) -> None:
        for robot in robots:
            if not isinstance(robot, AsyncRobot):
                raise BadValue(f"{robot!r} is not an AsyncRobot returned by urlink.connect_async")
        group = Group(*(robot._part for robot in robots))
        super().__init__(group, robots[0]._workers)
        self.robots = robots

    follow = motion(Group.follow)
    move_joints = motion(Group.move_joints)
    stop = stopping(Group.stop)
    stream = block(Group.stream, AsyncGroupStream)

    async def states(self, timeout: float | None = 5.0) -> AsyncIterator[tuple[RealtimeState, ...]]:
        """Iterate over the states of all arms, like `Group.states`: ``async for left, right in both.states()``."""
        moments = self._part._moments()
        others = {each: self.robots[each].realtime.iterate(drop_oldest(WAITING), timeout) for each in moments.others}
        async for state in self.robots[moments.first].realtime.iterate(latest, timeout):
            while (lacking := moments.lacking(state)) is not None:
                newer = await anext(others[lacking], None)
                if newer is None:
                    return
                moments.take(lacking, newer)
            states = moments.at(state)
            if states is not None:
                yield states

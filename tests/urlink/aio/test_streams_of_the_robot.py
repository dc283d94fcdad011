"""The streams of an `AsyncRobot` belong to its robot, and end with the robot."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine
from typing import Any

import pytest

import urlink
from linkcore.errors import Closed
from urlink.aio.async_robot import AsyncRobot
from urlink.packets import RealtimeState

pytestmark = pytest.mark.simulated_time


def _with_robot(test: Callable[[AsyncRobot], Coroutine[Any, Any, None]]) -> AsyncRobot:
    """Run a coroutine with a robot on a simulator; return the robot after its block."""

    async def run() -> AsyncRobot:
        robot = await urlink.connect_async("sim://")
        async with robot:
            await test(robot)
        return robot

    return asyncio.run(run())


@pytest.mark.parametrize("name", ["realtime", "primary", "secondary"])
def test_attribute_returns_stream_of_same_name(name: str) -> None:
    async def test(robot: AsyncRobot) -> None:
        stream = getattr(robot, name)
        assert stream.stream.name.endswith(f" {name}")
        await stream.wait()

    _with_robot(test)


def test_leaving_the_block_closes_the_robot() -> None:
    async def test(robot: AsyncRobot) -> None:
        await robot.realtime.wait()

    robot = _with_robot(test)
    with pytest.raises(Closed):
        asyncio.run(robot.realtime.wait())


@pytest.mark.parametrize("kind", [None, RealtimeState], ids=["all", "of a class"])
def test_deadline_of_a_subscription_reports_silence(kind: type | None) -> None:
    async def test(robot: AsyncRobot) -> None:
        silences: list[float] = []
        await robot.realtime.wait()
        options: Any = {} if kind is None else {"kind": kind}
        subscription = await robot.realtime.subscribe(
            lambda state: None, deadline=0.3, on_deadline=silences.append, **options
        )
        robot.controller.faults.stall(2.0)
        await asyncio.sleep(1.5)
        subscription.close()
        assert silences

    _with_robot(test)


def test_closed_iterator_takes_no_more_packets() -> None:
    async def test(robot: AsyncRobot) -> None:
        packets = robot.realtime.iterate()
        await packets.__anext__()
        await packets.aclose()
        offered = packets.stats.offered
        for _ in range(3):
            await robot.realtime.wait()
        assert packets.stats.offered == offered

    _with_robot(test)

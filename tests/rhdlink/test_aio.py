"""A robot in a program that uses asyncio."""

from __future__ import annotations

import asyncio
import contextlib
import threading
from collections.abc import Callable, Coroutine, Iterator
from typing import Any

import pytest

import rhdlink.aio
from rhdlink import Closed, ConnectFailed, Drive, Host, LinkTimeout, LocalError, Mission
from rhdlink.host.plugins.turtle import Turtle
from rhdlink.host.world import World
from rhdlink.robots import VelocityOmega
from tests.cancelling import Sent, Trial, run_cancelled, sends
from tests.fakes.rhd import Peer, ScriptedServer, nothing_more_after_greeting
from tests.waiting import until

pytestmark = pytest.mark.real_time

__all__ = ["sends"]


@pytest.fixture
def turtle() -> Turtle:
    return Turtle(World(1000.0))


@pytest.fixture
def host(turtle: Turtle) -> Iterator[Host]:
    with Host([turtle], period=0.005, port=0) as host:
        yield host


def test_robot_is_driven_while_other_tasks_run(host: Host, turtle: Turtle) -> None:
    async def drive() -> int:
        others = 0

        async def count() -> None:
            nonlocal others
            while True:
                others += 1
                await asyncio.sleep(0)

        async with rhdlink.aio.connect(host.address, VelocityOmega, access="w") as robot:
            counting = asyncio.create_task(count())
            robot.variables.cmdtransvel = 0.5
            async for variables in robot.updates():
                if variables.transpos > 2000:
                    break
            counting.cancel()
        return others

    assert asyncio.run(drive()) > 100  # there would be only one run per sync if the loop blocked
    assert turtle.world.odometry.x > 0.02


async def connected(address: str) -> None:
    async with rhdlink.connect_async(address, VelocityOmega, access="w"):
        pass


async def synced(address: str) -> None:
    async with rhdlink.connect_async(address, VelocityOmega, access="w") as robot:
        robot.variables.cmdtransvel = 0.5
        for _ in range(3):
            await robot.sync()


async def updated(address: str) -> None:
    async with rhdlink.connect_async(address, VelocityOmega, access="w") as robot:
        async for _ in robot.updates():
            return


@pytest.mark.parametrize("use", [connected, synced, updated])
def test_cancelled_calls_end_immediately_and_leave_nothing(
    host: Host, use: Callable[[str], Coroutine[Any, Any, None]], sends: list[Sent]
) -> None:
    async def work(trial: Trial) -> None:
        with trial:
            await use(host.address)

    number, was_cancelled = 0, True
    while was_cancelled:
        number += 1
        was_cancelled, late = run_cancelled(number, work, sends)
        assert not late, number
    assert number > 3


def test_connect_async_needs_an_asyncio_loop(host: Host) -> None:
    """Other libraries, such as trio, step coroutines without an asyncio loop."""
    with pytest.raises(LocalError, match="connect_async needs a running asyncio event loop"):
        connected(host.address).send(None)


def test_closed_robot_leaves_no_thread(host: Host) -> None:
    async def connect_and_close() -> None:
        robot = await rhdlink.aio.connect(host.address)
        await robot.sync()
        assert "tick" in robot.variables
        await robot.close()
        await robot.close()
        with pytest.raises(Closed):
            await robot.sync()

    before = threading.active_count()
    asyncio.run(connect_and_close())
    until(lambda: threading.active_count() <= before)


def test_connect_raises_when_no_server_listens() -> None:
    async def connect() -> None:
        async with rhdlink.aio.connect("localhost:1"):
            raise AssertionError("connected although no server listens")

    with pytest.raises(ConnectFailed):
        asyncio.run(connect())


def test_sync_gets_its_own_reply_after_cancelled_syncs(host: Host) -> None:
    async def give_up() -> None:
        async with rhdlink.aio.connect(host.address) as robot:
            for _ in range(20):
                with contextlib.suppress(asyncio.TimeoutError):
                    await asyncio.wait_for(robot.sync(), 1e-4)
            await robot.sync()
            ticks = [robot.variables["tick"]]
            await robot.sync()
            assert robot.variables["tick"] > ticks[0]

    asyncio.run(give_up())


def test_connection_made_after_a_cancelled_connect_is_closed() -> None:
    is_given_up = threading.Event()

    def late(peer: Peer) -> None:
        assert is_given_up.wait(10.0)
        nothing_more_after_greeting(peer)

    async def impatient(address: str) -> None:
        async def connect() -> None:
            await rhdlink.aio.connect(address)

        with pytest.raises(asyncio.TimeoutError):
            await asyncio.wait_for(connect(), 0.05)
        is_given_up.set()

    with ScriptedServer(late) as server:  # the script waits until the client has left
        asyncio.run(impatient(server.address))


def test_sync_times_out_when_the_robot_is_silent(host: Host, turtle: Turtle) -> None:
    goes_on = threading.Event()

    async def wait() -> None:
        async with rhdlink.aio.connect(host.address) as robot:
            turtle.periodic = lambda tick: goes_on.wait(10.0)  # type: ignore[method-assign, assignment]

            async def sync_thrice() -> None:  # one or two replies may already have been sent
                for _ in range(3):
                    await robot.sync(0.05)

            with pytest.raises(LinkTimeout):
                await sync_thrice()
            goes_on.set()

    asyncio.run(wait())


def test_missions_and_motions_can_be_awaited() -> None:
    async def drive() -> tuple[float, float]:
        with Drive(Turtle(World(1000.0))) as drive:
            await drive.forward(0.2)
            driven = drive.pose.x
        run = Mission("fwd 0.1\n", Turtle(World(1000.0))).start()
        await run
        return driven, run.pose.x

    assert asyncio.run(drive()) == pytest.approx((0.2, 0.1), abs=0.02)

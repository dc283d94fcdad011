"""Stops do not queue behind waiting calls, and cancelled tasks leave nothing running."""

from __future__ import annotations

import asyncio
import contextlib
import threading
from collections.abc import AsyncIterator, Awaitable, Callable, Coroutine, Iterator
from typing import Any

import numpy as np
import pytest

import urlink
from linkcore import clock
from linkcore.errors import Cancelled, LinkError
from linkcore.pending_call import PendingCall
from tests.urlink.aio.every_awaitable import FAR, MOVEJ, READY, is_busy
from urlink import Trajectory
from urlink.aio.async_group import AsyncGroup
from urlink.motion.stream.stream_points import PointReader
from urlink.simulator import Controller, Still

pytestmark = pytest.mark.simulated_time

#: Delay of the network in each direction, in s.
LATENCY = 0.02
PLAYED = {"p.urp": f"def p():\n  {MOVEJ}\nend\n"}


def controllers(sim: urlink.Simulation, count: int) -> Iterator[list[Controller]]:
    """Start controllers, each on its own computer."""
    with contextlib.ExitStack() as stack:
        made = []
        for number in range(count):
            host = f"192.168.0.{100 + number}"
            cell = sim.computer(f"cell-{number}", host)
            with sim.on(cell):
                controller = Controller(
                    "UR5e", "5.25", host=host, ports="standard", motion=Still(READY), files=PLAYED
                ).start()
            made.append(controller)
            stack.callback(closed, sim, cell, controller)
            for route in (sim.network.route(sim.here, cell), sim.network.route(cell, sim.here)):
                route.latency = LATENCY
        yield made


def closed(sim: urlink.Simulation, cell: Any, controller: Controller) -> None:
    with sim.on(cell):
        controller.close()


@pytest.fixture
def both(simulated_time: urlink.Simulation) -> Iterator[list[Controller]]:
    yield from controllers(simulated_time, 2)


@pytest.fixture
def controller(simulated_time: urlink.Simulation) -> Iterator[Controller]:
    for made in controllers(simulated_time, 1):
        yield made[0]


@contextlib.asynccontextmanager
async def connected(controller: Controller) -> AsyncIterator[urlink.AsyncRobot]:
    async with urlink.connect_async(controller.address) as robot:
        await robot.realtime.wait()
        yield robot


def target(robot: urlink.AsyncRobot) -> Any:
    state = robot.realtime.latest
    assert state is not None
    return state.q_target


async def given_up(robot: urlink.AsyncRobot, count: int) -> None:
    """Start `count` calls that wait for an input, and cancel them."""
    tasks = [asyncio.create_task(robot.io.wait_digital_in(0, True, timeout=15.0)) for _ in range(count)]
    await asyncio.sleep(0.1)
    for task in tasks:
        task.cancel()
    await asyncio.gather(*tasks, return_exceptions=True)


async def waiting(robot: urlink.AsyncRobot, count: int) -> list[asyncio.Task[Any]]:
    """Start `count` calls that wait for an input until the robot is closed."""

    async def wait() -> None:
        with contextlib.suppress(LinkError):
            await robot.io.wait_digital_in(0, True, timeout=15.0)

    tasks = [asyncio.create_task(wait()) for _ in range(count)]
    await asyncio.sleep(0.1)
    return tasks


async def cancelled(use: Coroutine[Any, Any, object], after: float) -> bool:
    """Whether the call was cancelled after some seconds, rather than finished before."""
    task = asyncio.create_task(use)
    await asyncio.sleep(after)
    task.cancel()
    await asyncio.gather(task, return_exceptions=True)
    return task.cancelled()


async def comes_to_rest(robot: urlink.AsyncRobot, seconds: float = 2.0) -> bool:
    """Whether the arm is at rest after some time, and stays at rest."""
    await asyncio.sleep(seconds)
    here = target(robot)
    await asyncio.sleep(0.5)
    return bool(np.abs(target(robot) - here).max() < 1e-6)


# -- stops during waiting calls ------------------------------------------------------------------------


def test_cancelled_waits_free_their_threads_at_once(controller: Controller) -> None:
    async def main() -> None:
        async with connected(controller) as robot:
            for _ in range(3):
                await given_up(robot, 16)
                began = clock.now()
                while is_busy(robot._workers):
                    assert clock.now() - began < 0.01
                    await asyncio.sleep(0.001)
                await robot.io.set_digital_out(0, True)
                assert clock.now() - began < 1.0

    asyncio.run(main())


def test_stop_does_not_queue_behind_waits(controller: Controller) -> None:
    async def main() -> None:
        async with connected(controller) as robot:
            await robot.motion.move_joints(FAR, speed=0.1, wait=False)
            await waiting(robot, 40)
            began = clock.now()
            await robot.motion.stop()
            assert clock.now() - began < 0.1
            assert await comes_to_rest(robot)

    asyncio.run(main())


def test_force_mode_block_ends_at_once_while_calls_wait(controller: Controller) -> None:
    async def main() -> None:
        async with connected(controller) as robot:
            async with robot.motion.force_mode("base", [0, 0, 1, 0, 0, 0], [0, 0, -30, 0, 0, 0], [0.1] * 6):
                await waiting(robot, 40)
                began = clock.now()
            assert clock.now() - began < 1.0

    asyncio.run(main())


def test_close_takes_at_most_two_seconds_while_calls_wait(controller: Controller) -> None:
    async def main() -> None:
        async with connected(controller) as robot:
            await robot.motion.move_joints(FAR, speed=0.1, wait=False)
            await waiting(robot, 100)
            began = clock.now()
        assert clock.now() - began < 2.0
        await asyncio.sleep(1.0)
        assert not controller.arm.is_moving

    asyncio.run(main())


def test_stops_need_no_new_thread(controller: Controller, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(thread: threading.Thread) -> None:
        raise RuntimeError("can't start new thread")

    async def main() -> None:
        async with connected(controller) as robot:
            motion = await robot.motion.move_joints(FAR, speed=0.1, wait=False)
            async with robot.motion.force_mode("base", [0, 0, 1, 0, 0, 0], [0, 0, -10, 0, 0, 0], [0.1] * 6):
                monkeypatch.setattr(threading.Thread, "start", refuse)
                await robot.motion.stop()
            assert motion.done
        assert not controller.arm.is_moving

    asyncio.run(main())


# -- effects of cancelled tasks ------------------------------------------------------------------------


@pytest.mark.parametrize("after", [0.01, 0.03, 0.05, 0.5])
@pytest.mark.parametrize("wait", [False, True])
def test_cancelled_execute_does_not_move_the_arm(controller: Controller, wait: bool, after: float) -> None:
    async def main() -> None:
        async with connected(controller) as robot:
            interpreter = await robot.interpreter()
            if await cancelled(interpreter.execute(MOVEJ, wait=wait), after):
                assert await comes_to_rest(robot)
            else:
                assert not wait
                assert after > 2.0 * LATENCY
            interpreter.cancel()

    asyncio.run(main())


async def replaced(robot: urlink.AsyncRobot, stream: Any, after: float, points: Any) -> None:
    await stream.append(points(0.0, 0.5, 0.02), wait=False)
    await asyncio.sleep(0.2)
    assert await cancelled(stream.replace(0.3, points(0.0, 5.0, 0.6)), after)
    assert await comes_to_rest(robot)
    assert stream.is_dry
    assert not stream.done


@pytest.mark.parametrize("after", [0.0, 0.001, 0.005, 0.02, 0.03])
def test_cancelled_replace_does_not_move_the_arm(controller: Controller, after: float) -> None:
    async def main() -> None:
        async with connected(controller) as robot, robot.motion.stream(buffer=0.3) as stream:
            q = target(robot)
            await replaced(robot, stream, after, lambda since, to, by: Trajectory.from_arrays([since, to], [q, q + by]))
            assert np.abs(target(robot) - q).max() < 0.05

    asyncio.run(main())


def test_unsent_replace_keeps_points(controller: Controller, monkeypatch: pytest.MonkeyPatch) -> None:
    """The task is cancelled while the new points are computed."""
    call = PendingCall()
    with urlink.connect(controller.address) as robot:
        q = robot.realtime.wait().q_target
        with robot.motion.stream(buffer=0.3) as stream:
            stream.append(Trajectory.from_arrays([0.0, 0.5], [q, q + 0.02]), wait=False)
            curve = PointReader.curve

            def computed(*arguments: Any) -> Any:
                call.give_up()
                return curve(*arguments)

            monkeypatch.setattr(PointReader, "curve", computed)
            with pytest.raises(Cancelled):
                call.make(lambda: stream.replace(0.3, Trajectory.from_arrays([0.0, 5.0], [q, q + 0.6])))
            stream.wait_until_dry()
            assert stream.end == 0.5


@pytest.mark.parametrize("after", [0.0, 0.001, 0.03])
def test_cancelled_replace_of_a_group_moves_no_arm(both: list[Controller], after: float) -> None:
    async def main() -> None:
        async with (
            connected(both[0]) as one,
            connected(both[1]) as two,
            AsyncGroup(one, two).stream(buffer=0.3) as stream,
        ):
            q = target(one)

            def points(since: float, to: float, by: float) -> list[Trajectory]:
                return [Trajectory.from_arrays([since, to], [q, q + by])] * 2

            await replaced(one, stream, after, points)
            assert np.abs(target(one) - q).max() < 0.05
            assert await comes_to_rest(two, 0.0)

    asyncio.run(main())


@pytest.mark.parametrize("after", [0.005, 0.02, 0.03])
def test_cancelled_play_is_undone(controller: Controller, after: float) -> None:
    async def main() -> None:
        async with connected(controller) as robot:
            await robot.dashboard.load("p.urp")
            assert await cancelled(robot.dashboard.play(), after)
            assert await comes_to_rest(robot)
            assert not await robot.dashboard.running()

    asyncio.run(main())


def test_cancelled_gripper_motion_is_undone(controller: Controller) -> None:
    async def main() -> None:
        async with connected(controller) as robot:
            await robot.gripper.activate()
            assert await cancelled(robot.gripper.close(speed=1), 0.3)
            await asyncio.sleep(0.5)
            here = await robot.gripper.position()
            await asyncio.sleep(0.5)
            assert await robot.gripper.position() == here < 200

    asyncio.run(main())


def test_cancelled_wait_of_a_stream_cancels_stream(controller: Controller) -> None:
    async def main() -> None:
        async with connected(controller) as robot, robot.motion.stream() as stream:
            assert await cancelled(stream.wait(), 0.1)
            await asyncio.sleep(0.1)
            assert stream.done

    asyncio.run(main())


# -- cancelled waits -----------------------------------------------------------------------------------

_WAITS: dict[str, tuple[float, Callable[[urlink.AsyncRobot], Awaitable[object]]]] = {
    "wait_digital_in": (0.5, lambda robot: robot.io.wait_digital_in(0, True, timeout=15.0)),
    "wait_for_stop": (0.5, lambda robot: robot.safety.wait_for_stop(15.0)),
    "set_payload": (0.03, lambda robot: robot.set_payload(0.3)),
    "dashboard": (0.03, lambda robot: robot.dashboard.generate_flight_report()),
    "connecting": (0.03, lambda robot: robot.tool_serial.read(5, timeout=15.0)),
    "tool_serial": (0.5, lambda robot: robot.tool_serial.read(5, timeout=15.0)),
    "gripper": (0.03, lambda robot: robot.gripper.wait()),
    "call": (0.5, lambda robot: robot.call(clock.sleep, 15.0)),
}


@pytest.mark.parametrize("name", _WAITS)
def test_cancelled_wait_frees_thread(name: str, controller: Controller) -> None:
    after, wait = _WAITS[name]

    async def main() -> None:
        async def use() -> None:
            await wait(robot)

        async with connected(controller) as robot:
            assert await cancelled(use(), after)
            await asyncio.sleep(0.06)
            assert not is_busy(robot._workers)

    asyncio.run(main())

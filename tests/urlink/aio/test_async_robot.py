"""A robot in an asyncio program, on a simulated controller."""

from __future__ import annotations

import asyncio
import threading
import time
from collections.abc import Coroutine, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import urlink
from linkcore.streaming import plotting
from tests.waiting import until
from urlink import Closed, ConnectFailed, LocalError, SafetyStop
from urlink.packets import SafetyMode
from urlink.simulator import Controller

pytestmark = pytest.mark.simulated_time

SOON = 30.0


@pytest.fixture
def controller() -> Iterator[Controller]:
    with Controller("UR5e", "5.11") as controller:
        yield controller


@pytest.fixture(autouse=True)
def is_clear(controller: Controller) -> None:
    controller.faults.clear()


def run(test: Coroutine[Any, Any, None]) -> None:
    """Run a test with a time limit; no task and no thread may remain."""

    async def bounded() -> None:
        await asyncio.wait_for(test, SOON)
        assert asyncio.all_tasks() == {asyncio.current_task()}

    before = threading.active_count()
    asyncio.run(bounded())
    until(lambda: threading.active_count() <= before)


def test_streams_are_read_without_a_thread(controller: Controller) -> None:
    async def read() -> None:
        before = threading.active_count()
        async with urlink.connect_async(controller.address) as robot, urlink.connect_async(controller.address) as other:
            assert (str(robot.firmware), robot.model) == ("5.11", "UR5e")
            assert robot.kinematics.model.name == "UR5e"
            times = []
            async with robot.realtime.iterate(urlink.block) as states:
                async for state in states:
                    times.append(state.time)
                    if len(times) == 50:
                        break
                assert (states.stats.delivered, states.stats.dropped) == (50, 0)
            assert np.allclose(np.diff(times), 0.002)
            both = await asyncio.gather(
                other.realtime.wait(), robot.primary.of(urlink.packets.RobotModeData).wait(), robot.secondary.wait()
            )
            assert [type(each).__name__ for each in both] == ["RealtimeState", "RobotModeData", "RobotState"]
            ours = threading.enumerate()[before:]
            assert all(" stop" in thread.name for thread in ours), ours
        with pytest.raises(Closed):
            await robot.realtime.wait()

    run(read())


def test_motions_and_commands_are_awaited(controller: Controller, tmp_path: Path) -> None:
    async def command() -> None:
        async with urlink.connect_async(controller.address) as robot:
            begin = (await robot.realtime.wait()).q_actual
            handle = await robot.motion.move_joints(begin + 0.05, speed=1.0, wait=False)
            assert not handle.done
            await handle
            assert handle.phase is urlink.Phase.DONE
            assert np.allclose((await robot.realtime.wait()).q_actual, begin + 0.05, atol=1e-3)
            await robot.io.set_digital_out(2, True)
            assert await robot.io.digital_out(2)
            assert await robot.dashboard.robot_mode() is urlink.packets.RobotMode.RUNNING
            assert await robot.call(lambda: robot.safety.mode) is SafetyMode.NORMAL
            async with robot.rtde.outputs("timestamp", "actual_q", frequency=125) as stream:
                first, second = await stream.wait(), await stream.wait()
                assert second.timestamp > first.timestamp
            async with robot.record(tmp_path / "run.urlog", ["realtime"]):
                await robot.realtime.wait()
            with pytest.raises(urlink.BadValue):
                await robot.motion.move_joints([1, 2, 3], wait=True)
            assert threading.active_count() < 12

    run(command())
    with urlink.connect(tmp_path / "run.urlog") as robot:
        assert robot.realtime.wait().q_actual.shape == (6,)


def test_starting_a_motion_requires_wait(controller: Controller) -> None:
    """A moving arm must not be mistaken for an arm at its target: in the first releases, `await` waited for the arm."""

    async def command() -> None:
        async with urlink.connect_async(controller.address) as robot:
            q = (await robot.realtime.wait()).q_actual
            pose = (await robot.realtime.wait()).tool_vector_actual
            trajectory = urlink.Trajectory.from_arrays(time=[0, 1], q=[q, q + 0.1])
            motion = robot.motion
            for begun in (
                motion.move_joints(q + 0.1),
                motion.move_linear(pose),
                motion.move_circular(pose, pose),
                motion.path([urlink.Joint(q + 0.1)]),
                motion.speed_joints([0.1] * 6),
                motion.speed_linear([0.1] * 6),
                motion.follow(trajectory),
                motion.until_contact([0, 0, -1, 0, 0, 0]),
                robot.script.run("movej([0, 0, 0, 0, 0, 0])"),
            ):
                with pytest.raises(urlink.BadValue, match=r"without `wait`, so nothing was sent; pass wait=True"):
                    await begun
            assert motion.current is None
            assert np.array_equal((await robot.realtime.wait()).qd_actual, np.zeros(6))
            # A stop is sent in any case.
            moving = await motion.speed_joints([0.1] * 6, duration=10.0, wait=False)
            with pytest.raises(LocalError, match="await it in asyncio"):
                moving.wait(cancel=False)
            stop = await motion.stop()
            await stop
            assert isinstance(moving.error, urlink.Cancelled)
            ended = await motion.speed_joints([0.0] * 6, duration=0.1, wait=True)
            assert ended.done

    run(command())


def test_each_async_part_works_like_its_blocking_part(controller: Controller) -> None:
    async def use() -> None:
        async with urlink.connect_async(controller.address) as robot:
            async with robot.interpreter() as interpreter:
                assert await interpreter.execute("set_digital_out(3, True)", wait=True) > 0
                assert (await interpreter.state()).last_interpreted >= 1
                assert not interpreter.done
            assert interpreter.phase is urlink.Phase.DONE
            boards = robot.primary.of(urlink.packets.MasterboardData)
            await boards.wait_until(lambda board: bool(board.digital_output_bits & 1 << 3))
            assert await robot.io.digital_out(3)
            alone = await robot.interpreter()
            await alone.execute("sleep(60)")
            alone.cancel()
            with pytest.raises(urlink.Cancelled):
                await alone
            async with robot.rtde.inputs("input_int_register_24") as inputs:
                await inputs.send(input_int_register_24=7)
                assert inputs.names == ("input_int_register_24",)
            registers = await robot.rtde.registers()
            await registers.write_integer(25, 8)
            async with robot.teach() as teaching:
                await teaching.record()
            assert len(teaching.taught) == 1
            assert (await robot.gripper.activate()).is_active
            assert (await robot.gripper.close()).position == await robot.gripper.position() > 0
            robot.safety.policy = "never"
            assert robot.safety.policy == "never"
            outputs = await robot.rtde.outputs("timestamp", frequency=125)
            assert (outputs.names, outputs.frequency, outputs.is_over) == (("timestamp",), 125, False)
            assert (await outputs.description())["asked"] == ["timestamp"]
            assert outputs.recipe is not None
            await outputs.close()
            assert outputs.is_over

    run(use())


@pytest.mark.slow
def test_async_stream_has_history_and_live_plot(controller: Controller, monkeypatch: pytest.MonkeyPatch) -> None:
    drawn: list[tuple[plotting.Plot, float]] = []
    monkeypatch.setattr(plotting.LivePlot, "update", lambda self, plot, pause: drawn.append((plot, pause)))

    async def look() -> None:
        async with urlink.connect_async(controller.address) as robot:
            with await robot.realtime.history(5.0) as history:
                await robot.realtime.wait_until(lambda state: len(history) > 2)
                assert history.array("q_actual")["q_actual"].shape[1:] == (6,)
            with pytest.raises(urlink.BadValue, match="no field"):
                await robot.realtime.plot("nothing", seconds=1.0)
            plotting_it = asyncio.create_task(robot.realtime.plot("q_actual", seconds=0.3, period=0.05))
            turns = 0
            while not plotting_it.done():  # the loop continues meanwhile
                await asyncio.sleep(0.001)
                turns += 1
            await plotting_it
            assert turns > 10
            assert len(drawn[0][0].figure().axes[0].lines) == 6
            assert all(pause < 0.01 for _, pause in drawn)

    run(look())


def test_cancelled_interpreter_block_stops_arm(controller: Controller) -> None:
    async def use() -> None:
        async with urlink.connect_async(controller.address) as robot:

            async def wait_long() -> None:
                async with robot.interpreter() as interpreter:
                    await interpreter.execute("speedj([0.1, 0, 0, 0, 0, 0], 1.0, 60)")
                    entered.set()
                # leaving the block waits for the statement

            waiting = asyncio.create_task(wait_long())
            await entered.wait()
            await robot.realtime.wait_until(lambda state: bool(np.any(np.abs(state.qd_actual) > 0.05)))
            began = time.monotonic()
            waiting.cancel()
            with pytest.raises(asyncio.CancelledError):
                await waiting
            assert time.monotonic() - began < SOON / 2
            await robot.realtime.wait_until(lambda state: bool(np.all(state.qd_actual == 0)))

    entered = asyncio.Event()
    run(use())


def test_cancelled_or_timed_out_motion_stops_arm(controller: Controller) -> None:
    async def give_up() -> None:
        async with urlink.connect_async(controller.address) as robot:
            begin = (await robot.realtime.wait()).q_actual
            motion = asyncio.create_task(robot.motion.move_joints(begin - 0.5, speed=0.1, wait=True))
            await robot.realtime.wait_until(lambda state: bool(np.any(np.abs(state.qd_actual) > 0.05)))
            handle = robot.motion.current
            assert handle is not None
            with pytest.raises(asyncio.TimeoutError):
                await asyncio.wait_for(motion, 0.01)
            await robot.realtime.wait_until(lambda state: bool(np.all(state.qd_actual == 0)))
            assert handle.phase is urlink.Phase.CANCELLED
            # A call that is cancelled before it is sent is not sent.
            never = asyncio.create_task(robot.motion.move_joints(begin, wait=True))
            await asyncio.sleep(0)
            never.cancel()
            with pytest.raises(asyncio.CancelledError):
                await never
            await robot.realtime.wait_until(lambda state: bool(np.all(state.qd_actual == 0)))

    run(give_up())


def test_cancelled_task_stops_arm(controller: Controller) -> None:
    async def drive() -> None:
        async with urlink.connect_async(controller.address) as robot:
            q = (await robot.realtime.wait()).q_actual
            async with robot.motion.servo() as servo:
                async for _ in robot.realtime:
                    q = q + 1e-4
                    servo.send(q)
                    driven.set()

    async def cancel() -> None:
        driving = asyncio.create_task(drive())
        await driven.wait()
        driving.cancel()
        with pytest.raises(asyncio.CancelledError):
            await driving
        async with urlink.connect_async(controller.address) as robot:
            await robot.realtime.wait_until(lambda state: bool(np.all(state.qd_actual == 0)))

    driven = asyncio.Event()
    run(cancel())


def test_stop_does_not_queue_behind_waiting_calls(controller: Controller) -> None:
    async def stop() -> None:
        async with urlink.connect_async(controller.address) as robot:
            waiting = asyncio.create_task(_awaited(robot.io.wait_digital_in(5, timeout=SOON)))
            begin = (await robot.realtime.wait()).q_actual
            motion = await robot.motion.move_joints(begin + 0.5, speed=0.1, wait=False)
            await robot.motion.stop(wait=True)
            with pytest.raises(urlink.Cancelled):
                await motion
            assert not waiting.done()
            controller.faults.protective_stop()
            with pytest.raises(SafetyStop):
                await robot.motion.move_joints(begin, wait=True)
            waiting.cancel()
            controller.faults.clear()
            # A thread that waits for the input remains; it ends with the robot.

    run(stop())


@pytest.mark.slow
@pytest.mark.parametrize("is_handle", [True, False])
def test_delayed_loop_can_still_stop_arm(controller: Controller, is_handle: bool) -> None:
    """Data that the robot has sent meanwhile is read before the robot counts as silent."""

    async def hold_up() -> None:
        async with urlink.connect_async(controller.address, stale_after=0.3) as robot:
            begin = (await robot.realtime.wait()).q_actual
            moving = robot.motion.move_joints(begin + 0.5, speed=0.1, wait=not is_handle)
            waiting = asyncio.create_task(_awaited(await moving if is_handle else moving))
            await robot.realtime.wait_until(lambda state: bool(np.any(np.abs(state.qd_actual) > 0.05)))
            handle = robot.motion.current
            assert handle is not None
            waiting.cancel()
            time.sleep(0.6)  # the loop reads nothing in this time
            await asyncio.wait({waiting})
            assert waiting.cancelled()
            await robot.realtime.wait_until(lambda state: bool(np.all(state.qd_target == 0)), timeout=4.0)
            assert handle.phase is urlink.Phase.CANCELLED

    run(hold_up())


async def _awaited(call: Any) -> object:
    return await call


def test_stream_reconnects(controller: Controller) -> None:
    async def lose() -> None:
        async with urlink.connect_async(controller.address) as robot:
            async with robot.realtime.iterate(urlink.block) as states:
                await anext(states)
                controller.faults.cut("realtime")
                async for _ in states:
                    if robot.realtime.stats.reconnects:
                        break
            assert str((await robot.identify()).firmware) == "5.11"

    run(lose())


def test_failed_and_cancelled_connects_raise(tmp_path: Path) -> None:
    async def connect() -> None:
        with pytest.raises(ConnectFailed):
            await urlink.connect_async("ur://127.0.0.1?primary=1&secondary=1")
        with pytest.raises(urlink.BadValue):
            urlink.connect_async("sim://", timeout=-1)
        with pytest.raises(TypeError, match="tiemout"):
            urlink.connect_async("sim://", tiemout=1)  # type: ignore[call-arg]
        with pytest.raises(LocalError, match="is a recording"):
            await urlink.connect_async(tmp_path / "run.urlog")
        # One server accepts the connection and sends nothing; the other connection is still being made.
        silent = await asyncio.start_server(lambda reader, writer: writers.append(writer), "127.0.0.1", 0)
        port = silent.sockets[0].getsockname()[1]
        for address in (f"ur://127.0.0.1?primary={port}", "sim://"):
            connecting = asyncio.create_task(_awaited(urlink.connect_async(address)))
            await asyncio.sleep(0)
            while address != "sim://" and not writers:
                await asyncio.sleep(0.001)
            connecting.cancel()
            with pytest.raises(asyncio.CancelledError):
                await connecting
        writers[0].close()
        silent.close()
        await asyncio.sleep(0)

    writers: list[asyncio.StreamWriter] = []

    run(connect())


def test_connect_requires_an_asyncio_loop(controller: Controller) -> None:
    """Neither trio, which steps coroutines itself, nor a thread without a loop is supported."""
    with pytest.raises(LocalError, match=r"connect_async needs a running asyncio event loop.* trio"):
        _awaited(urlink.connect_async(controller.address)).send(None)

    async def command_elsewhere() -> None:
        async with urlink.connect_async(controller.address) as robot:
            with pytest.raises(LocalError, match="needs a running asyncio event loop"):
                await asyncio.to_thread(lambda: robot.motion.stop().send(None))

    run(command_elsewhere())


def test_read_only_robot_has_no_commands(controller: Controller) -> None:
    async def read() -> None:
        async with urlink.connect_async(controller.address, read_only=True) as robot:
            assert (await robot.realtime.wait()).q_actual.shape == (6,)
            with pytest.raises(LocalError, match="read_only"):
                _ = robot.motion.move_joints

    run(read())

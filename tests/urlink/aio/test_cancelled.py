"""Cancel each stream, command and block of a robot at each turn of the event loop."""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

import urlink
from tests.cancelling import Sent, Trial, run_cancelled, sends, turns
from tests.waiting import until
from urlink import Circular, Joint, Linear
from urlink.protocol.rtde.packets import InputsRequest
from urlink.simulator import Controller, Still
from urlink.simulator.interfaces import rtde
from urlink.simulator.interfaces.rtde import RtdeSession

pytestmark = pytest.mark.simulated_time

__all__ = ["sends"]

READY = [0.3, -1.57, 1.57, -1.57, -1.57, 0.0]
POSE_STEP = 0.01

#: Time in s of silence that a busy machine may cause.
SLOW = 10.0

Use = Callable[[Any], Awaitable[object]]


@pytest.fixture
def controller() -> Iterator[Controller]:
    with Controller("UR5e", "5.25", motion=Still(READY)) as controller:
        yield controller


def q(robot: Any) -> list[float]:
    """Return a target that is never far: on one side of READY, or on the other."""
    here = robot.realtime.latest.q_actual
    return [READY[0] + (0.05 if here[0] < READY[0] else -0.05), *READY[1:]]


def pose(robot: Any, by: float = POSE_STEP) -> list[float]:
    here: list[float] = robot.realtime.latest.tool_vector_actual.tolist()
    return [here[0], here[1], 0.45 + (by if here[2] < 0.45 else -by), *here[3:]]


def arc(robot: Any) -> tuple[list[float], list[float]]:
    via, end = pose(robot, POSE_STEP / 2), pose(robot)
    return [via[0] + 0.002, *via[1:]], end


# -- streams ------------------------------------------------------------------------------------


async def iterated(robot: Any) -> None:
    async with robot.realtime.iterate(urlink.block, timeout=5) as states:
        async for _ in states:
            if states.stats.delivered == 5:
                break


async def iterated_plainly(robot: Any) -> None:
    async for _ in robot.primary:
        break


async def subscribed(robot: Any) -> None:
    come = asyncio.Event()
    with await robot.secondary.subscribe(lambda state: come.set()):
        await come.wait()


async def outputs(robot: Any) -> None:
    async with robot.rtde.outputs("timestamp", "actual_q", frequency=125) as stream:
        await stream.wait()


async def closed(robot: Any) -> None:
    await robot.realtime.wait()
    await robot.realtime.close()


STREAMS: dict[str, Use] = {
    "wait": lambda robot: robot.realtime.wait(),
    "wait_until": lambda robot: robot.realtime.wait_until(lambda state: True),
    "start": lambda robot: robot.secondary.start(),
    "of": lambda robot: robot.primary.of(urlink.packets.RobotModeData).wait(),
    "iterate": iterated,
    "async for": iterated_plainly,
    "subscribe": subscribed,
    "outputs": outputs,
    "close": closed,
    "identify": lambda robot: robot.identify(),
}

# -- commands ------------------------------------------------------------------------------------

FAST = {"speed": 0.5, "acceleration": 10.0}


def there_and_back(robot: Any) -> urlink.Trajectory:
    here = robot.realtime.latest.q_actual.tolist()
    return urlink.Trajectory.from_arrays(time=[0, 0.1, 0.2], q=[here, [*here[:5], here[5] + 0.01], here])


async def handle(robot: Any) -> None:
    motion = await robot.motion.move_joints(q(robot), **FAST, wait=False)
    await motion


async def stopped(robot: Any) -> None:
    await (await robot.motion.stop())


async def gripped(robot: Any) -> None:
    await robot.gripper.activate()
    await robot.gripper.close()


async def plotted(robot: Any) -> None:
    with await robot.realtime.history(1.0) as history:
        await robot.realtime.wait()
        assert len(history)


COMMANDS: dict[str, Use] = {
    "move_joints": lambda robot: robot.motion.move_joints(q(robot), **FAST, wait=False),
    "move_joints wait": lambda robot: robot.motion.move_joints(q(robot), wait=True, **FAST),
    "awaited handle": handle,
    "move_linear": lambda robot: robot.motion.move_linear(pose(robot), **FAST, wait=True),
    "move_circular": lambda robot: robot.motion.move_circular(*arc(robot), **FAST, wait=True),
    "path": lambda robot: robot.motion.path([Linear(pose(robot)), Joint(q(robot))], speed=0.5, wait=True),
    "path of an arc": lambda robot: robot.motion.path([Circular(*arc(robot))], speed=0.5, wait=True),
    "speed_joints": lambda robot: robot.motion.speed_joints([0, 0, 0, 0, 0, 0.1], duration=0.1, wait=True),
    "speed_linear": lambda robot: robot.motion.speed_linear([0, 0, 0.01, 0, 0, 0], duration=0.1, wait=True),
    "stop": stopped,
    "follow": lambda robot: robot.motion.follow(there_and_back(robot), watchdog=0.5, wait=True),
    "script": lambda robot: robot.script.run("sleep(0.05)", wait=False),
    "script wait": lambda robot: robot.script.run("sleep(0.05)", wait=True),
    "send_line": lambda robot: robot.script.send_line("set_analog_out(0, 0.1)"),
    "set_digital_out": lambda robot: robot.io.set_digital_out(1, True),
    "set_payload": lambda robot: robot.set_payload(1.0),
    "set_tcp": lambda robot: robot.set_tcp([0, 0, 0, 0, 0, 0]),
    "set_speed_slider": lambda robot: robot.set_speed_slider(1.0),
    "zero_force_sensor": lambda robot: robot.zero_force_sensor(),
    "popup": lambda robot: robot.popup("Hello"),
    "dashboard": lambda robot: robot.dashboard.robot_mode(),
    "register": lambda robot: robot.registers.write_integer(25, 1),
    "wait_enabled": lambda robot: robot.safety.wait_enabled(5),
    "gripper": gripped,
    "history": plotted,
    "call": lambda robot: robot.call(time.sleep, 0.01),
}

# -- blocks ------------------------------------------------------------------------------------


async def servo(robot: Any) -> None:
    async with robot.motion.servo(watchdog=0.5) as servo:
        async for state in robot.realtime:
            servo.send(state.q_target)
            if servo.stats.count == 5:
                break


async def streamed(robot: Any, **how: Any) -> None:
    async with robot.motion.stream(**how) as stream:
        here = robot.realtime.latest.q_target.tolist()
        await stream.append(urlink.TrajectoryPoint([*here[:5], here[5] + 0.01], 0.2, [0] * 6))
        await stream.replace(0.1, urlink.TrajectoryPoint([*here[:5], here[5] + 0.02], 0.3, [0] * 6))
        await stream.clear()


def left_soon(block: Callable[[Any], Any]) -> Use:
    async def use(robot: Any) -> None:
        async with block(robot):
            await robot.realtime.wait()

    return use


async def moved(robot: Any) -> None:
    with await robot.motion.move_joints(q(robot), speed=0.1, wait=False):
        await robot.realtime.wait()


async def interpreted(robot: Any) -> None:
    async with robot.interpreter() as interpreter:
        await interpreter.execute("sleep(0.05)", wait=True)


async def written(robot: Any) -> None:
    async with robot.rtde.inputs("input_int_register_24") as inputs:
        await inputs.send(input_int_register_24=1)


OVER_RTDE, STREAM_OVER_RTDE = "servo over RTDE", "stream over RTDE"
BLOCKS: dict[str, Use] = {
    "servo": servo,
    "jog": left_soon(lambda robot: robot.motion.jog("tool", watchdog=0.5)),
    "force_mode": left_soon(
        lambda robot: robot.motion.force_mode("base", [0, 0, 1, 0, 0, 0], [0] * 6, [0.1] * 6, watchdog=0.5)
    ),
    "torque": left_soon(lambda robot: robot.motion.torque(watchdog=0.5)),
    "impedance": left_soon(lambda robot: robot.motion.impedance()),
    "freedrive": left_soon(lambda robot: robot.freedrive(watchdog=0.5)),
    "teach": left_soon(lambda robot: robot.teach()),
    "stream": streamed,
    STREAM_OVER_RTDE: lambda robot: streamed(robot, link="rtde"),
    OVER_RTDE: left_soon(lambda robot: robot.motion.servo(watchdog=0.5, link="rtde")),
    "a motion": moved,
    "interpreter": interpreted,
    "inputs": written,
}

USES = {**STREAMS, **COMMANDS, **BLOCKS}


def stands(controller: Controller) -> bool:
    return not controller.is_running_program and not controller.arm.is_moving


def may_follow(name: str, data: bytes) -> bool:
    """Whether data may be sent after a task has ended: to stop the arm, or to open an RTDE connection.

    The message of a link that stops is all zeros, and ends with its date of 4 bytes. RTDE packages begin with their
    size and their type; "U" is a data package, which a link over RTDE sends to stop. A call of `stop` is made even if
    the task that awaits it has ended.
    """
    types = (b"V", b"v", b"O", b"I", b"S", *([b"U"] if name in (OVER_RTDE, STREAM_OVER_RTDE) else []))
    stops_link = len(data) > 4 and not any(data[:-4])
    is_stop = name == "stop" and b"\n  stopj(" in data
    return is_stop or b"urlink_stop" in data or stops_link or data[2:3] in types


@contextlib.asynccontextmanager
async def connected(address: str) -> AsyncIterator[Any]:
    async with urlink.connect_async(address, stale_after=SLOW) as robot:
        await robot.realtime.wait(SLOW)
        yield robot


def check(number: int, controller: Controller, sent: list[Sent], work: Callable[[Trial], Any], name: str = "") -> bool:
    was_cancelled, late = run_cancelled(number, work, sent)
    assert not [each for each in late if not may_follow(name, each)], number
    # A script waits five seconds for its start permission, if its robot was closed before.
    until(lambda: stands(controller), 5.0 if was_cancelled else 10.0)
    return was_cancelled


@pytest.mark.matrix
@pytest.mark.parametrize("name", USES)
def test_cancelled_call_ends_at_once_and_leaves_nothing(name: str, controller: Controller, sends: list[Sent]) -> None:
    async def work(trial: Trial) -> None:
        async with connected(controller.address) as robot:
            with trial:
                await USES[name](robot)

    for number in turns(list(USES).index(name)):
        if not check(number, controller, sends, work, name):
            break


@pytest.mark.matrix
def test_cancelled_connect_leaves_nothing(controller: Controller, sends: list[Sent]) -> None:
    async def work(trial: Trial) -> None:
        with trial:
            async with urlink.connect_async(controller.address):
                pass

    number = 1
    while check(number, controller, sends, work):
        number += 1
    assert number > 3
    assert not sends


@pytest.mark.matrix
@pytest.mark.parametrize("row", range(6))
def test_task_cancelled_while_connecting_does_not_move_arm(row: int, controller: Controller, sends: list[Sent]) -> None:
    async def work(trial: Trial) -> None:
        with trial:
            async with urlink.connect_async(controller.address) as robot:
                await robot.motion.move_joints(READY, speed=0.5, wait=True)

    for number in turns(row):
        if not check(number, controller, sends, work):
            break


@pytest.mark.matrix
def test_cancelled_recording_is_closed(tmp_path: Path, controller: Controller, sends: list[Sent]) -> None:
    async def work(trial: Trial) -> None:
        async with connected(controller.address) as robot:
            with trial:
                async with robot.record(tmp_path / f"{number}.urlog"):
                    await robot.realtime.wait()

    for number in turns(5):
        if not check(number, controller, sends, work):
            break


def test_cancelled_claim_of_inputs_leaves_no_task(controller: Controller, monkeypatch: pytest.MonkeyPatch) -> None:
    """The controller has accepted the connection of an RTDE link, and hangs."""
    asked = asyncio.Event()

    async def servo() -> None:
        async with urlink.connect_async(controller.address, stale_after=SLOW) as robot:
            await robot.realtime.wait(SLOW)
            loop = asyncio.get_running_loop()

            def unanswered(session: RtdeSession, request: object) -> None:
                loop.call_soon_threadsafe(asked.set)

            monkeypatch.setitem(rtde._ANSWERS, InputsRequest, unanswered)
            async with robot.motion.servo(link="rtde"):
                raise AssertionError("the claim must not be answered")

    async def cancel() -> None:
        leading = asyncio.create_task(servo())
        await asked.wait()
        leading.cancel()
        with pytest.raises(asyncio.CancelledError):
            await leading
        assert asyncio.all_tasks() == {asyncio.current_task()}

    asyncio.run(cancel())

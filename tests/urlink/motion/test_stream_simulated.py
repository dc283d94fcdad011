"""Streams on the simulated controller: both interfaces, each generation, and slowed robots."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

import urlink
from linkcore.errors import BadValue, Cancelled, Closed, ConnectionLost, LinkTimeout, LocalError
from linkcore.handle import Phase
from tests.waiting import until
from urlink import InputInUse, Trajectory, TrajectoryPoint
from urlink.aio.parts import AsyncPointStream
from urlink.motion import PointStream, PosePoint
from urlink.motion.motions import LinkName
from urlink.robot import Robot
from urlink.rtde.outputs import OutputStream

pytestmark = pytest.mark.simulated_time

TIMEOUT = 120.0
#: Joint positions in rad: elbow up, tool down.
READY = np.array([0.0, -1.6, 1.6, -1.6, -1.6, 0.0])
STILL = [0.0] * 6


@pytest.fixture
def connect() -> Iterator[Callable[..., Robot]]:
    """Return a function that connects to a simulated arm at rest at `READY`."""
    made: list[Robot] = []

    def connect(arm: str = "ur5e", firmware: str = "5.11") -> Robot:
        robot = urlink.connect(f"sim://{arm}?firmware={firmware}", stale_after=20.0, silence=30.0)
        made.append(robot)
        robot.motion.move_joints(READY, speed=2.0, acceleration=10.0).wait(TIMEOUT)
        return robot

    yield connect
    for robot in made:
        robot.close()


def turned(angle: float) -> Any:
    return READY + np.array([*STILL[:5], angle])


def points(first: int, last: int, spacing: float = 0.05, speed: float = 0.5) -> list[TrajectoryPoint]:
    """Return points of wrist 3 at a constant speed, as if it could move at that speed since 0.1 s."""
    return [
        TrajectoryPoint(turned(speed * (spacing * i - 0.1)), spacing * i, [*STILL[:5], speed], STILL)
        for i in range(first, last + 1)
    ]


def stands(robot: Robot) -> bool:
    return bool(np.abs(robot.realtime.wait(5).qd_actual).max() < 1e-3)


@pytest.mark.slow
@pytest.mark.matrix(3)
@pytest.mark.parametrize(
    ("arm", "firmware", "link"),
    [
        *[
            ("ur5", "3.4", "reverse"),
            ("ur5", "3.15", "reverse"),
            ("ur5e", "5.11", "reverse"),
            ("ur5e", "10.12", "reverse"),
        ],
        *[("ur5", "3.9", "rtde"), ("ur5e", "5.3", "rtde"), ("ur5e", "10.12", "rtde")],
    ],
)
def test_stream_runs_from_first_to_last_point(
    connect: Callable[..., Robot], arm: str, firmware: str, link: LinkName
) -> None:
    robot = connect(arm, firmware)
    with robot.motion.stream(buffer=0.3, link=link) as stream:
        assert stream.is_dry
        assert stream.time == stream.end == stream.buffered == 0.0
        assert robot.motion.current is stream
        stream.append(TrajectoryPoint(turned(0.05), 0.2, [*STILL[:5], 0.5], STILL))
        rooms = [stream.append(point) for point in points(5, 30)]
        assert min(rooms) > -0.1
        assert stream.buffered == pytest.approx(0.3, abs=0.12)
        stream.wait_until_dry(TIMEOUT)
        # The last point has a speed, so the arm had to brake.
        assert stream.starved == 1
        assert stream.time == pytest.approx(1.5)
        until(lambda: stands(robot))
        assert turned(0.7)[5] < robot.realtime.wait(5).q_actual[5] < turned(0.8)[5]
        stream.append(TrajectoryPoint(turned(0.8), 2.5, STILL, STILL))
        stream.wait_until_dry(TIMEOUT)
        assert stream.starved == 1
        until(lambda: stands(robot))
        assert robot.realtime.wait(5).q_actual == pytest.approx(turned(0.8), abs=1e-3)
    assert stream.phase is Phase.DONE
    with pytest.raises(Closed):
        stream.append(points(60, 60))
    with pytest.raises(Closed):
        stream.clear()


@pytest.mark.parametrize("link", ["reverse", "rtde"])
def test_leaving_block_stops_arm(connect: Callable[..., Robot], link: LinkName) -> None:
    robot = connect()
    with robot.motion.stream(link=link) as stream:
        stream.append(points(4, 60), wait=False)
        until(lambda: stream.time > 0.5)
        assert stream.room < 0.0
    assert stream.phase is Phase.DONE
    assert stands(robot)
    assert robot.realtime.wait(5).q_actual[5] < 0.5
    with pytest.raises(LocalError, match="within its block"):
        robot.motion.stream().append(points(4, 5))


@pytest.mark.slow
@pytest.mark.matrix(2)
@pytest.mark.parametrize(("slider", "link"), [(0.5, "reverse"), (0.2, "reverse"), (0.2, "rtde")])
def test_slider_slows_stream_on_path(connect: Callable[..., Robot], slider: float, link: LinkName) -> None:
    robot = connect()
    with robot.motion.stream(link=link) as stream:
        began = robot.realtime.wait(5).time
        stream.append(TrajectoryPoint(turned(0.3), 1.0, STILL, STILL))
        robot.set_speed_slider(slider)
        stream.append(TrajectoryPoint(turned(0.0), 2.0, STILL, STILL))
        until(lambda: stream.time > 1.1)
        robot.set_speed_slider(0.01)
        at = stream.time
        before = robot.realtime.wait(5).time
        until(lambda: robot.realtime.wait(5).time > before + 1.0)
        assert stream.time < at + 0.15
        robot.set_speed_slider(1.0)
        stream.wait_until_dry(TIMEOUT)
        assert robot.realtime.wait(5).time - began > 1.0 + 0.9 / slider
        assert stream.starved == 0
        assert stream.time == pytest.approx(2.0)
    assert robot.realtime.wait(5).q_actual == pytest.approx(READY, abs=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("link", ["reverse", "rtde"])
def test_points_are_replaced_and_cleared(connect: Callable[..., Robot], link: LinkName) -> None:
    robot = connect()
    with robot.motion.stream(link=link) as stream:
        stream.append(points(4, 60), wait=False)
        until(lambda: stream.time > 0.5)
        since = stream.replace(stream.time, Trajectory.from_arrays([0, 1, 2], [turned(0.2), turned(0.4), turned(0.5)]))
        assert 0.5 < since < 0.6
        assert stream.end == pytest.approx(2.5, abs=0.05)
        until(lambda: stream.time > 1.0)
        assert stream.clear() == pytest.approx(stream.end)
        stream.wait_until_dry(TIMEOUT)
        assert stream.starved == 0
        until(lambda: stands(robot))
        here = robot.realtime.wait(5).q_target
        pose = robot.kinematics.forward(here) + np.array([0, 0, 0.05, 0, 0, 0])
        stream.append(PosePoint(pose, stream.end + 1.0))
        stream.wait_until_dry(TIMEOUT)
        assert stream.starved == 1  # a pose has no speed, so the stream does not end at rest


@pytest.mark.slow
def test_points_are_replaced_before_arm_moves(connect: Callable[..., Robot]) -> None:
    """While the speed rises from 0, the program has its points several cycles before it moves the arm to them."""
    robot = connect()
    path = Trajectory.from_arrays([0, 1], [READY, turned(0.1)])
    with robot.motion.stream() as stream:
        stream.append(path)
        for _ in range(10):
            assert stream.replace(stream.time, path) < 0.05


@pytest.mark.slow
def test_registers_serve_consecutive_streams_and_motions(connect: Callable[..., Robot]) -> None:
    robot = connect()
    for angle in (0.1, 0.2):
        with robot.motion.stream(link="rtde") as stream:
            stream.append(TrajectoryPoint(turned(angle), 0.5, STILL, STILL))
            stream.wait_until_dry(TIMEOUT)
            assert stream.time == pytest.approx(0.5)
        assert stream.phase is Phase.DONE
        way = Trajectory.from_arrays([0, 0.5], [turned(angle), READY])
        robot.motion.follow(way, link="rtde").wait(TIMEOUT)
        robot.motion.move_joints(turned(angle), speed=1.0).wait(TIMEOUT)


@pytest.mark.slow
def test_register_of_another_client_raises_input_in_use(connect: Callable[..., Robot]) -> None:
    robot = connect()
    with robot.rtde.inputs("input_int_register_43"), pytest.raises(InputInUse, match="input_int_register_43"):
        robot.motion.stream(link="rtde").__enter__()
    with robot.motion.stream(link="rtde") as stream:
        assert stream.is_dry


@pytest.mark.slow
def test_missing_outputs_end_stream(connect: Callable[..., Robot]) -> None:
    """The reports of the program are then unknown; it brakes because it receives no messages."""
    robot = connect()
    with robot.motion.stream(buffer=2.0, link="rtde") as stream:
        stream.append(points(4, 200), wait=False)
        until(lambda: stream.time > 0.3)
        outputs = [each for each in robot.rtde._open if isinstance(each, OutputStream)]
        outputs[0].close()
        with pytest.raises(ConnectionLost, match="no output registers have arrived"):
            stream.wait(TIMEOUT)
        until(lambda: stands(robot))


@pytest.mark.slow
def test_points_from_a_second_thread_are_rejected(connect: Callable[..., Robot]) -> None:
    robot = connect()
    raised: list[Exception] = []
    with robot.motion.stream() as stream:

        def append() -> None:
            try:
                stream.append(points(4, 60))
            except Exception as error:
                raised.append(error)

        thread = threading.Thread(target=append)
        thread.start()
        until(lambda: stream.end > 0.0)
        with pytest.raises(LocalError, match="another thread or task"):
            stream.append(points(61, 62))
        with pytest.raises(LocalError, match="another thread or task"):
            stream.replace(0.0, points(61, 62))
        stream.clear()
        thread.join(TIMEOUT)
        assert [type(error) for error in raised] == [Cancelled]
        stream.wait_until_dry(TIMEOUT)
        with pytest.raises(LinkTimeout, match=r"no room for the points within 0\.2 s"):
            stream.append([TrajectoryPoint(point.q, stream.end + point.time) for point in points(20, 60)], wait=0.2)


@pytest.mark.slow
def test_invalid_calls_are_rejected(connect: Callable[..., Robot]) -> None:
    robot = connect()
    with robot.motion.stream() as stream:
        with pytest.raises(BadValue, match="expected a TrajectoryPoint"):
            stream.append([3])  # type: ignore[list-item]
        with pytest.raises(BadValue, match="from_time"):
            stream.replace(-1.0, points(1, 2))
        stream.append(points(4, 60), wait=False)
        with pytest.raises(LinkTimeout, match=r"not run dry within 0\.1 s"):
            stream.wait_until_dry(0.1)
    with (
        urlink.connect("sim://ur5?firmware=1.8") as old,
        pytest.raises(LocalError, match=r"CB2 .* 3\.4 or later is required"),
    ):
        old.motion.stream()
    with (
        urlink.connect("sim://ur5?firmware=3.8") as old,
        pytest.raises(LocalError, match=r"3\.9, 5\.3 or later is required"),
    ):
        old.motion.stream(link="rtde")
    with urlink.connect("sim://ur5?firmware=3.1") as old, pytest.raises(LocalError, match=r"3\.4 or later is required"):
        old.motion.stream()


@pytest.mark.slow
def test_another_motion_ends_stream(connect: Callable[..., Robot]) -> None:
    robot = connect()
    with robot.motion.stream() as stream:
        stream.append(points(4, 60), wait=False)
        until(lambda: stream.time > 0.3)
        robot.motion.move_joints(READY).wait(TIMEOUT)
        with pytest.raises(Cancelled):
            stream.append(points(61, 62))
        with pytest.raises(Cancelled):
            stream.wait_until_dry()
    assert stream.phase is Phase.CANCELLED


@pytest.mark.slow
def test_async_robot_can_append_points_to_a_stream() -> None:
    async def use() -> None:
        async with urlink.connect_async("sim://ur5e?firmware=5.11") as robot:
            await robot.motion.move_joints(READY, 2.0, 10.0, wait=True)
            async with robot.motion.stream(buffer=0.3) as stream:
                assert stream.is_dry
                assert await stream.append(points(4, 10)) <= 0.3
                appending = asyncio.ensure_future(stream.append(points(11, 200)))
                while stream.end < 10.0:
                    await asyncio.sleep(0.01)
                assert not appending.done()
                appending.cancel()
                while stream.end > 9.0:
                    await asyncio.sleep(0.01)
                assert stream.end < 2.0
                await stream.replace(stream.time, Trajectory.from_arrays([0, 2], [turned(0.3), turned(0.3)]))
                await stream.clear()
                await stream.wait_until_dry(TIMEOUT)
                assert stream.starved == 0
            assert stream.phase is Phase.DONE
            assert isinstance(await robot.motion.stream(), AsyncPointStream)

    asyncio.run(use())


def test_point_stream_is_a_motion() -> None:
    assert issubclass(PointStream, urlink.Motion)

"""Motions without a script, on a turtle in this process."""

from __future__ import annotations

import asyncio
import math
import threading
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

from linkcore.errors import LinkError
from rhdlink import BadValue, Cancelled, Closed, Drive, LinkTimeout, Phase
from rhdlink.host.plugins.turtle import SmrTurtle, Turtle
from rhdlink.host.scene import Scene, Tape
from rhdlink.host.world import World
from rhdlink.smrcl.robot_link import PluginLink
from tests.waiting import interrupted, until

pytestmark = pytest.mark.simulated_time

#: Timeout in s; simulated time passes quickly, but not on a loaded machine.
SECONDS = 30.0


@pytest.fixture(params=["velomega", "differential"])
def robot(request: pytest.FixtureRequest) -> Turtle | SmrTurtle:
    world = World(1000.0)
    return Turtle(world) if request.param == "velomega" else SmrTurtle(world)


@pytest.fixture
def drive(robot: Turtle | SmrTurtle) -> Iterator[Drive]:
    with Drive(robot) as drive:
        yield drive


def pose(robot: Turtle | SmrTurtle) -> tuple[float, float, float]:
    """Return the pose of the robot in m, m and degrees."""
    x, y, theta = robot.world.odometry
    return x, y, math.degrees(theta)


def is_stopped(robot: Turtle | SmrTurtle) -> bool:
    if isinstance(robot, Turtle):
        return robot.cmdtransvel == robot.cmdrotvel == 0
    return robot.speedl == robot.speedr == 0


@pytest.mark.parametrize(
    ("motion", "end"),
    [
        (lambda drive: drive.forward(0.5), (0.5, 0.0, 0.0)),
        (lambda drive: drive.forward(-0.3), (-0.3, 0.0, 0.0)),
        (lambda drive: drive.turn(90), (0.0, 0.0, 90.0)),
        (lambda drive: drive.turn(-270), (0.0, 0.0, -270.0)),
        (lambda drive: drive.arc(0.5, 90), (0.5, 0.5, 90.0)),
        (lambda drive: drive.arc(0.5, -90), (0.5, -0.5, -90.0)),
        (lambda drive: drive.to(1.0, 1.0, 90.0), (1.0, 1.0, 90.0)),
        (lambda drive: drive.stop(), (0.0, 0.0, 0.0)),
    ],
)
def test_motion_ends_at_its_goal(
    robot: Turtle | SmrTurtle, motion: Callable[[Drive], object], end: tuple[float, float, float]
) -> None:
    with Drive(robot) as drive:
        handle = motion(drive)
        handle.wait(SECONDS)  # type: ignore[attr-defined]
        assert handle.phase is Phase.DONE  # type: ignore[attr-defined]
        assert handle.progress == 1.0  # type: ignore[attr-defined]
    # The robot comes to rest after the end of its last motion.
    assert pose(robot) == pytest.approx(end, abs=0.03, rel=0.05)
    assert is_stopped(robot)


def test_position_errors_of_successive_motions_do_not_add_up(drive: Drive, robot: Turtle | SmrTurtle) -> None:
    for _ in range(4):
        drive.forward(0.4).wait(SECONDS)
        drive.turn(90).wait(SECONDS)
    until(lambda: is_stopped(robot))
    x, y, theta = pose(robot)
    assert (x, y) == pytest.approx((0.0, 0.0), abs=0.02)
    assert theta == pytest.approx(360.0, abs=2.0)
    assert (drive.pose.x, drive.pose.y) == pytest.approx((x, y), abs=0.005)


@pytest.mark.slow
def test_new_motion_preempts_the_current_one_at_speed(drive: Drive, robot: Turtle | SmrTurtle) -> None:
    first = drive.forward(50.0)
    until(lambda: drive.velocity > 0.2)
    assert 0.0 < first.progress < 0.5
    second = drive.along(0.0, 0.0, 0.0)
    with pytest.raises(Cancelled, match="preempted by another motion"):
        first.wait(SECONDS)
    until(lambda: second.phase is Phase.RUNNING)
    assert drive.velocity > 0.2
    drive.stop().wait(SECONDS)
    assert second.phase is Phase.CANCELLED
    until(lambda: is_stopped(robot))


@pytest.mark.slow
def test_motion_begins_where_its_predecessor_was_cancelled(drive: Drive, robot: Turtle | SmrTurtle) -> None:
    drive.forward(50.0)
    until(lambda: drive.pose.x > 0.3)
    drive.arc(10.0, 90.0)
    drive.stop().wait(SECONDS)
    until(lambda: is_stopped(robot))
    x = drive.pose.x
    drive.forward(0.2).wait(SECONDS)
    assert drive.pose.x == pytest.approx(x + 0.2, abs=0.03)


@pytest.mark.slow
def test_cancelled_motion_stops_the_robot(drive: Drive, robot: Turtle | SmrTurtle) -> None:
    motion = drive.wheels(0.2, 0.2)
    motion.wait(SECONDS)
    motion = drive.forward(50.0)
    until(lambda: motion.phase is Phase.RUNNING)
    motion.cancel()
    assert motion.phase is Phase.CANCELLED
    with pytest.raises(Cancelled):
        motion.wait(SECONDS)
    until(lambda: is_stopped(robot))


@pytest.mark.real_time
def test_interrupted_wait_cancels_the_motion(drive: Drive, robot: Turtle | SmrTurtle) -> None:
    motion = drive.forward(500.0)
    interrupted(lambda: motion.wait(SECONDS, cancel=False), lambda: not is_stopped(robot))
    assert not motion.done
    interrupted(lambda: motion.wait(SECONDS))
    assert motion.phase is Phase.CANCELLED
    until(lambda: is_stopped(robot))


@pytest.mark.slow
def test_leaving_the_with_block_cancels_the_motion(drive: Drive, robot: Turtle | SmrTurtle) -> None:
    with drive.along(0.0, 0.0, 45.0) as motion:
        until(lambda: drive.pose.x > 0.3)
        assert motion.progress == 0.0
        assert drive.pose.y > 0.0
        assert "moving" in repr(drive)
    until(lambda: is_stopped(robot))
    until(lambda: "idle" in repr(drive))


def test_motion_can_be_awaited_and_calls_back(drive: Drive) -> None:
    called = threading.Event()

    async def both() -> None:
        await drive.forward(0.1)
        motion = drive.turn(30)
        motion.add_done_callback(lambda motion: drive.forward(0.1).add_done_callback(lambda _: called.set()))
        await motion

    asyncio.run(both())
    assert called.wait(SECONDS)


def test_wheels_turn_the_robot_on_the_spot(drive: Drive, robot: Turtle | SmrTurtle) -> None:
    drive.wheels(-0.1, 0.1).wait(SECONDS)
    until(lambda: abs(math.degrees(robot.world.odometry.theta)) > 45.0)
    drive.stop().wait(SECONDS)
    assert math.hypot(*robot.world.odometry[:2]) < 0.02
    assert robot.world.odometry.theta > 0.0


def test_speed_and_acceleration_are_applied() -> None:
    robot = Turtle(World(1000.0))
    with Drive(robot, speed=0.1, acceleration=0.5) as drive:
        drive.forward(0.3).wait(SECONDS)
        slow = robot.host.tick
        drive.forward(0.3, speed=0.4).wait(SECONDS)
        assert slow > 300
        assert robot.host.tick - slow < 200


@pytest.mark.slow
def test_follow_line_stays_on_the_tape() -> None:
    world = World(11.0, (1.0, 5.0, 0.0), Scene([Tape(((1.0, 5.0), (3.0, 5.0), (6.0, 6.0)))]))
    with Drive(SmrTurtle(world)) as drive:
        motion = drive.follow_line("bm")
        until(lambda: drive.pose.x > 3.0, SECONDS)
        assert abs(drive.line_position) < 5.0
        assert not motion.done
        motion.cancel()
    # The tape rises by 1 m over 3 m.
    assert world.pose.y == pytest.approx(5.0 + (world.pose.x - 3.0) / 3.0, abs=0.12)


@pytest.mark.slow
@pytest.mark.parametrize("side", ["left", "right"])
def test_follow_wall_keeps_its_distance(side: str) -> None:
    y = 5.4 if side == "left" else 4.6
    world = World(11.0, (1.0, 5.0, 0.0), Scene(walls=[((0.5, y), (10.0, y))]))
    with Drive(SmrTurtle(world)) as drive:
        drive.forward(0.1).wait(SECONDS)
        assert drive.distances[0 if side == "left" else 4] == pytest.approx(0.4, abs=0.03)
        drive.follow_wall(side, 0.3)
        until(lambda: drive.pose.x > 4.0, SECONDS)
        drive.stop().wait(SECONDS)
    assert abs(world.pose.y - y) == pytest.approx(0.3, abs=0.05)


@pytest.mark.real_time
def test_obstacle_stops_the_robot_but_not_the_motion() -> None:
    world = World(4.0, (1.0, 2.0, 0.0), Scene(walls=[((2.0, 1.0), (2.0, 3.0))]))
    with Drive(SmrTurtle(world)) as drive:
        motion = drive.forward(2.0)
        until(lambda: world.pose.x > 1.7, SECONDS)
        with pytest.raises(LinkTimeout, match="and continues"):
            motion.wait(0.2)
    assert world.pose.x < 1.9


@pytest.mark.parametrize(
    "refused",
    [
        lambda drive: drive.forward(math.nan),
        lambda drive: drive.forward(math.inf),
        lambda drive: drive.forward("far"),
        lambda drive: drive.turn(1e9),
        lambda drive: drive.arc(0.0, 90),
        lambda drive: drive.arc(-0.5, 90),
        lambda drive: drive.to(1.0, 1.0, 0.0, radius=0.0),
        lambda drive: drive.follow_line("green"),
        lambda drive: drive.follow_wall("front", 0.3),
        lambda drive: drive.follow_wall("left", -0.3),
        lambda drive: drive.wheels(0.1, None),
        lambda drive: drive.wheels(11.0, 0.1),
        lambda drive: drive.wheels(0.1, -11.0),
        lambda drive: drive.forward(1.0, speed=math.nan),
        lambda drive: drive.forward(True),
        lambda drive: drive.arc(True, 90),
        lambda drive: drive.forward(1e7),
    ],
)
def test_drive_rejects_invalid_motions(refused: Callable[[Drive], object]) -> None:
    with Drive(Turtle()) as drive:
        with pytest.raises(BadValue, match="expected"):
            refused(drive)
        assert drive.error is None


@pytest.mark.parametrize("speed", [-1.0, 0.0, 100.0, 10.01])
@pytest.mark.parametrize(
    "begin",
    [
        lambda drive, speed: drive.forward(0.5, speed=speed),
        lambda drive, speed: drive.turn(90, speed=speed),
        lambda drive, speed: drive.arc(0.5, 90, speed=speed),
        lambda drive, speed: drive.to(1.0, 1.0, 0.0, speed=speed),
        lambda drive, speed: drive.along(1.0, 1.0, 0.0, speed=speed),
        lambda drive, speed: drive.follow_line(speed=speed),
        lambda drive, speed: drive.follow_wall("left", 0.3, speed=speed),
    ],
)
def test_drive_rejects_impossible_speeds(begin: Callable[[Drive, float], object], speed: float) -> None:
    robot = Turtle()
    with Drive(robot) as drive:
        with pytest.raises(BadValue, match=r"^speed is .* 10 m/s"):
            begin(drive, speed)
        assert drive._motions.is_idle


@pytest.mark.parametrize("kind", [np.int64, np.float32])
def test_drive_accepts_numpy_numbers(kind: Any) -> None:
    robot = Turtle(World(1000.0))
    with Drive(robot, speed=kind(1), acceleration=kind(1)) as drive:
        drive.forward(kind(1)).wait(SECONDS)
    assert pose(robot)[0] == pytest.approx(1.0, abs=0.01)


def test_drive_rejects_invalid_arguments() -> None:
    refused: list[dict[str, Any]] = [
        *({"speed": speed} for speed in (math.nan, True, -0.3, 0.0, 100.0)),
        *({"acceleration": acceleration} for acceleration in (0.0, -1.0, 101.0)),
        {"compat": "loud"},
    ]
    for arguments in refused:
        with pytest.raises(BadValue):
            Drive(Turtle(), **arguments)
    with pytest.raises(LinkError):
        Drive("localhost:1")


@pytest.mark.slow
def test_closed_drive_stops_and_rejects_motions() -> None:
    robot = Turtle(World(1000.0))
    link = PluginLink([robot])
    drive = Drive(link)
    motion = drive.forward(100.0)
    until(lambda: drive.pose.x > 0.2)
    drive.close()
    drive.close()
    assert is_stopped(robot)
    with pytest.raises(Closed):
        motion.wait(SECONDS)
    with pytest.raises(Closed):
        drive.forward(1.0)
    assert "closed" in repr(drive)
    assert link.writers == 1
    # The next drive starts at the current pose of the robot.
    with Drive(link) as again:
        again.forward(0.2).wait(SECONDS)
        assert again.pose.x == pytest.approx(0.2, abs=0.02)
    link.close()

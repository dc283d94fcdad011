"""Motions on the simulated controller that are cancelled, stopped or cut off in the middle, beside `follow`."""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Iterator

import numpy as np
import pytest

import urlink
from linkcore.errors import Cancelled, ConnectionLost, LinkError
from linkcore.handle import Motion, Phase
from tests.waiting import until
from urlink import Joint, Linear
from urlink.errors import NotRunning, SafetyStop
from urlink.robot import Robot

Begin = Callable[[Robot], Motion]
End = Callable[[Robot, Motion], type[LinkError]]

TIMEOUT = 30.0
#: Seconds that words may stay away: the machine that runs this may be busy with other things.
WATCHDOG = 3.0
#: rad; elbow up, tool down.
READY = np.array([0.0, -1.6, 1.6, -1.6, -1.6, 0.0])


def path(robot: Robot) -> Motion:
    up = robot.realtime.wait(5).tool_vector_actual.copy()
    up[2] += 0.1
    return robot.motion.path([Linear(up, blend=0.02), Joint(READY)], speed=0.2)


def circle(robot: Robot) -> Motion:
    pose = robot.realtime.wait(5).tool_vector_actual
    aside, back = np.array([0.05, 0.05, 0, 0, 0, 0]), np.array([0, 0.1, 0, 0, 0, 0])
    return robot.motion.move_circular(pose + aside, pose + back, speed=0.2)


def jog(robot: Robot) -> Motion:
    jog = robot.motion.jog("base", timeout=60.0, watchdog=WATCHDOG).__enter__()
    jog.move([0, 0, 0.1, 0, 0, 0])
    return jog


def servo(robot: Robot) -> Motion:
    servo = robot.motion.servo(target_filter="jerk_limited", watchdog=WATCHDOG).__enter__()
    servo.send(READY + 0.4)
    return servo


def cancelled(robot: Robot, motion: Motion) -> type[LinkError]:
    motion.cancel()
    return Cancelled


def stopped(robot: Robot, motion: Motion) -> type[LinkError]:
    robot.controller.faults.protective_stop()
    return SafetyStop


def cut_off(robot: Robot, motion: Motion) -> type[LinkError]:
    """Its own link, where it has one: the robot brakes by itself. Else that by which programs are sent: it goes on."""
    if motion.name in ("jog", "servo"):
        motion._life.brake.__self__._link.close()  # type: ignore[attr-defined]
        return ConnectionLost
    robot.controller.faults.cut("primary")
    return NotRunning


@pytest.fixture
def connect() -> Iterator[Callable[[str, str], Robot]]:
    """Connects to a simulated arm."""
    made: list[Robot] = []

    def connect(arm: str, firmware: str) -> Robot:
        # A machine that is busy with other things holds up the simulator too.
        made.append(urlink.connect(f"sim://{arm}?firmware={firmware}", stale_after=20.0, silence=30.0))
        return made[-1]

    yield connect
    for robot in made:
        robot.close()


_EACH = list(itertools.product((path, circle, jog, servo), (cancelled, stopped, cut_off)))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arm", "firmware", "ways"),
    # The three at 500 Hz cost more and are led by the same text: together they do each motion and each end.
    [
        ("ur5", "3.15", _EACH),
        ("ur5e", "5.11", _EACH[0::4]),
        ("ur5e", "5.25", _EACH[1::4]),
        ("ur5e", "10.12", _EACH[2::4]),
    ],
    ids=["3.15", "5.11", "5.25", "10.12"],
)
def test_each_way_to_end_each_motion(
    connect: Callable[[str, str], Robot], arm: str, firmware: str, ways: list[tuple[Begin, End]]
) -> None:
    """The handle says what ended it, the arm comes to rest, and it can go on."""
    robot = connect(arm, firmware)

    def speed() -> float:
        """Of the arm itself, not as streams tell of it."""
        return max(map(abs, robot.controller.arm.setpoint.qd))

    for begin, end in ways:
        until(lambda: robot.safety.is_enabled, TIMEOUT)
        robot.motion.move_joints(READY, speed=3.0, acceleration=30.0).wait(TIMEOUT)
        motion = begin(robot)
        moving = time.monotonic() + TIMEOUT
        while not motion.done and speed() < 0.05:
            assert time.monotonic() < moving
            time.sleep(0.002)
        assert not motion.done, (begin, end, motion.error)
        expected = end(robot, motion)
        with pytest.raises(expected):
            motion.wait(TIMEOUT)
        assert motion.phase is (Phase.CANCELLED if expected is Cancelled else Phase.FAILED)
        until(lambda: speed() == 0.0, TIMEOUT)
        robot.controller.faults.clear()

"""Motions on the simulated controller: each kind of `follow`, each kind of end, each generation."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

import urlink
from linkcore.errors import BadValue, ConnectionLost
from linkcore.handle import Motion, Phase
from tests.waiting import until
from urlink.motion import TrajectoryFeedback
from urlink.motion.links.reverse import ReverseLink
from urlink.motion.moves.trajectory import Trajectory
from urlink.robot import Robot
from urlink.simulator import Controller

pytestmark = pytest.mark.simulated_time

TIMEOUT = 120.0

#: (arm, firmware, options): each generation, and all variants of `follow`
WAYS: list[tuple[str, str, dict[str, Any]]] = [
    ("ur5", "1.8", {}),
    ("ur5", "3.4", {"low_bandwidth": True}),
    ("ur5", "3.15", {"link": "rtde"}),
    ("ur5e", "5.4", {"link": "rtde"}),
    ("ur5e", "5.11", {}),
    ("ur5e", "5.11", {"link": "rtde"}),
    ("ur5e", "10.12", {"link": "rtde"}),
]
#: Time without set-points in s that the robot accepts: the test machine may be busy.
WATCHDOG = 2.0

#: Joint positions in rad: elbow up, tool down.
READY = np.array([0.0, -1.6, 1.6, -1.6, -1.6, 0.0])


@pytest.fixture
def connect() -> Iterator[Callable[[str, str], Robot]]:
    """Return a function that connects to a simulated arm at rest at `READY`."""
    made: list[Robot] = []

    def connect(arm: str, firmware: str) -> Robot:
        # A busy machine also delays the simulator.
        robot = urlink.connect(f"sim://{arm}?firmware={firmware}", stale_after=20.0, silence=30.0)
        made.append(robot)
        robot.motion.move_joints(READY, speed=2.0, acceleration=10.0).wait(TIMEOUT)
        return robot

    yield connect
    for robot in made:
        robot.close()


def tool_path(robot: Robot, seconds: float = 0.8) -> Trajectory:
    """Return a trajectory from the current position: wrist 3 by 0.3 rad forth and back."""
    state = robot.realtime.wait(5)
    q = np.tile(state.q_target, (3, 1))
    q[1, 5] += 0.3
    return Trajectory.from_arrays([0, seconds / 2, seconds], q)


def stands(robot: Robot) -> bool:
    return bool(np.abs(robot.realtime.wait(5).qd_actual).max() < 1e-3)


def half_way(motion: Motion) -> None:
    until(lambda: motion.done or motion.progress > 0.4, TIMEOUT)
    assert not motion.done, motion.error


def goes_on(robot: Robot, way: dict[str, Any]) -> None:
    """Check that the robot can be used again: the arm follows another trajectory to its end."""
    until(lambda: stands(robot), TIMEOUT)
    path = tool_path(robot, 0.6)
    robot.motion.follow(path, **way, watchdog=WATCHDOG, goal_time=20.0).wait(TIMEOUT)
    assert robot.realtime.wait(5).q_actual == pytest.approx(path.q[-1], abs=0.01)


@pytest.mark.slow
@pytest.mark.parametrize(("arm", "firmware", "way"), WAYS)
def test_follow_reaches_end_of_trajectory(
    connect: Callable[[str, str], Robot], arm: str, firmware: str, way: dict[str, Any]
) -> None:
    robot = connect(arm, firmware)
    path = tool_path(robot)
    received: list[TrajectoryFeedback] = []
    motion = robot.motion.follow(path, **way, feedback=received.append, watchdog=WATCHDOG, goal_time=20.0)
    motion.wait(TIMEOUT)
    assert motion.phase is Phase.DONE
    assert robot.realtime.wait(5).q_actual == pytest.approx(path.q[-1], abs=0.01)
    assert len(received) > 10
    assert max(float(np.abs(each.error).max()) for each in received) < 0.3
    until(lambda: stands(robot))


@pytest.mark.slow
def test_silent_computer_ends_motion(connect: Callable[[str, str], Robot], monkeypatch: pytest.MonkeyPatch) -> None:
    """The watchdog on the robot expires: the link still exists, but no set-point arrives."""
    robot = connect("ur5e", "5.11")
    motion = robot.motion.follow(tool_path(robot, 4.0), watchdog=1.0)
    until(lambda: motion.done or motion.progress > 0.1, TIMEOUT)
    monkeypatch.setattr(ReverseLink, "send", lambda link, data: None)
    with pytest.raises(ConnectionLost, match="brakes on its own"):
        motion.wait(TIMEOUT)
    until(lambda: stands(robot), TIMEOUT)
    goes_on(robot, {})


@pytest.mark.slow
def test_closed_loop_moves_arm(connect: Callable[[str, str], Robot]) -> None:
    robot = connect("ur5e", "5.11")
    start = robot.realtime.wait(5)
    with robot.motion.servo(watchdog=WATCHDOG) as servo:
        for count, state in enumerate(robot.realtime):
            t = state.time - start.time
            servo.send([*start.q_target[:5], start.q_target[5] + 0.1 * np.sin(2 * t) ** 2])
            if count > 200:
                break
        assert servo.stats.count == 202
    assert servo.phase is Phase.DONE
    assert stands(robot)


@pytest.mark.slow
@pytest.mark.parametrize(("arm", "firmware"), [("ur5", "1.8"), ("ur5e", "5.11")])
def test_consecutive_speeds_keep_arm_moving(connect: Callable[[str, str], Robot], arm: str, firmware: str) -> None:
    robot = connect(arm, firmware)
    speeds = [0.0]
    with robot.realtime.subscribe(lambda state: speeds.append(float(state.qd_actual[5]))):
        until_then = time.monotonic() + 1.5
        while time.monotonic() < until_then:
            motion = robot.motion.speed_joints([0, 0, 0, 0, 0, 0.3], 2.0, duration=1.0)
            robot.realtime.wait(5)
        reached = next(i for i, speed in enumerate(speeds) if speed > 0.25)
        # When the arm has reached its speed, it keeps it.
        assert min(speeds[reached:]) > 0.2
        motion.wait(TIMEOUT)
        until(lambda: stands(robot), TIMEOUT)


@pytest.mark.slow
def test_trajectory_starting_elsewhere_is_rejected(connect: Callable[[str, str], Robot]) -> None:
    robot = connect("ur5e", "5.11")
    elsewhere = Trajectory.from_arrays([0, 1], [READY + 0.2, READY + 0.2])
    with pytest.raises(BadValue, match="too far from the position of the arm"):
        robot.motion.follow(elsewhere)


@pytest.mark.slow
def test_motion_starts_at_end_of_previous_motion(connect: Callable[[str, str], Robot]) -> None:
    """This holds even if the real-time interface was silent, so its newest state is older than that motion."""
    robot = connect("ur5e", "5.11")
    assert robot.controller is not None
    goal = np.array([*READY[:5], 0.2])
    robot.controller.faults.stall(2.0, "realtime")
    robot.motion.move_joints(goal, speed=2.0, acceleration=10.0).wait(TIMEOUT)
    path = Trajectory.from_arrays([0.0, 0.5, 1.0], [goal, READY, goal])
    robot.motion.follow(path, watchdog=WATCHDOG).wait(TIMEOUT)
    assert np.allclose(robot.realtime.wait(TIMEOUT).q_target, goal, atol=1e-3)


@pytest.mark.slow
def test_newest_of_delayed_states_is_used(
    connect: Callable[[str, str], Robot], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The states were delayed, and the first of them show the arm before the motion."""
    robot = connect("ur5e", "5.11")
    before = robot.realtime.wait(TIMEOUT)
    robot.motion.move_joints([*READY[:5], READY[5] + 0.2], speed=2.0, acceleration=10.0).wait(TIMEOUT)
    context = robot.motion._context
    context.programs.ended = float("inf")  # no existing state is newer
    monkeypatch.setattr(robot.realtime, "wait_until", lambda condition: before)
    state = context.state()
    assert state.time > before.time
    assert state.q_target[5] == pytest.approx(READY[5] + 0.2, abs=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("seconds", [0.1, 1.0])
def test_stop_ignored_in_local_control_is_repeated(connect: Callable[[str, str], Robot], seconds: float) -> None:
    robot = connect("ur5e", "5.11")
    assert robot.controller is not None
    motion = robot.motion.move_joints(READY - [1.5, 0, 0, 0, 0, 0], speed=0.2)
    half_way(motion)
    robot.controller.remote_control = False
    motion.cancel()
    time.sleep(seconds)
    assert not stands(robot)
    robot.controller.remote_control = True
    until(lambda: stands(robot), 1.0)
    assert robot.realtime.wait(TIMEOUT).q_target[0] > READY[0] - 1.4


def test_delayed_loop_does_not_move_arm_away() -> None:
    """The loop sends a set-point from before the delay, immediately the next one, and then nothing."""
    with Controller("UR5e", "5.11") as controller, urlink.connect(controller.address) as robot:
        q = robot.realtime.wait(5.0).q_target.copy()
        start = robot.realtime.wait(5.0).time
        with robot.motion.servo() as servo:
            for number, state in enumerate(robot.realtime):
                goal = [*q[:5], q[5] + 0.15 * (state.time - start)]
                if number == 100:
                    time.sleep(0.06)
                servo.send(goal)
                if number == 101:
                    break
            time.sleep(0.09)
            assert 0.0 < controller.arm.sample.q_target[5] - goal[5] < 0.01

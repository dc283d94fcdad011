"""Limits of a session on a simulated arm: refusals before anything is sent, and motions that stay inside."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import numpy as np
import pytest

import urlink
from linkcore import clock
from urlink import LimitExceeded, SessionLimits, Trajectory, TrajectoryPoint
from urlink.arm.vectors import FloatArray
from urlink.command.programs import Programs
from urlink.robot import Robot
from urlink.session.session_limits import KINDS

pytestmark = pytest.mark.simulated_time

TIMEOUT = 60.0
#: Joint positions in rad: elbow up, tool down; the TCP is at about (-0.47, -0.13, 0.3) m.
READY = np.array([0.0, -1.5, 2.0, -2.07, -1.57, 0.0])
#: Box of the TCP in m, with READY inside.
BOX = ((-0.6, -0.3, 0.12), (-0.3, 0.1, 0.4))


def at(*change: float) -> FloatArray:
    """Return `READY` with each joint turned by a number in rad."""
    return np.asarray(READY + np.array(change))


@contextlib.contextmanager
def limited(address: str = "sim://ur5?firmware=3.15", **limits: Any) -> Iterator[Robot]:
    """Connect to a simulated arm at rest at `READY`, with limits."""
    limits = {"box": BOX, "tool_speed": 0.25, "joint_speed": 1.0, **limits}
    with urlink.connect(address, limits=SessionLimits(**limits)) as robot:
        robot.motion.move_joints(READY, speed=0.2).wait(TIMEOUT)
        robot.realtime.wait_until(lambda state: not state.qd_target.any(), TIMEOUT)
        yield robot


@pytest.fixture
def sent(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Provide the names of the programs that are sent."""
    names: list[str] = []
    start = Programs.start

    def noting(programs: Programs, wrapped: Any, life: Any, **how: Any) -> None:
        names.append(life.name)
        start(programs, wrapped, life, **how)

    monkeypatch.setattr(Programs, "start", noting)
    return names


class Fastest:
    """Largest speeds of the arm since this object was made: of the tool in m/s, and of a joint in rad/s."""

    def __init__(self, robot: Robot) -> None:
        self._arm = robot.kinematics
        self.tool = self.joint = 0.0
        robot.realtime.subscribe(self._look, inline=True)

    def _look(self, state: urlink.packets.RealtimeState) -> None:
        velocity = self._arm.velocity(state.q_target, state.qd_target)
        self.tool = max(self.tool, float(np.linalg.norm(velocity[:3])))
        self.joint = max(self.joint, float(np.abs(state.qd_target).max()))


def pose(robot: Robot, **change: float) -> list[float]:
    """Return the pose of the tool, changed along the axes x, y and z by numbers in m."""
    values: list[float] = robot.realtime.wait().tool_vector_actual.tolist()
    for name, value in change.items():
        values["xyz".index(name)] += value
    return values


#: Name of the limit -> commands that exceed it.
BEYOND: dict[str, list[Callable[[Robot], object]]] = {
    "box": [
        lambda robot: robot.motion.move_joints(at(0, -0.4, 0, 0, 0, 0), speed=0.1),
        lambda robot: robot.motion.move_joints(at(1.2, 0, 0, 0, 0, 0), speed=0.1),
        lambda robot: robot.motion.move_linear(pose(robot, z=0.3)),
        lambda robot: robot.motion.move_circular(pose(robot, z=0.1, x=0.05), pose(robot, z=0.25)),
        # Both ends of this arc are in the box, and its middle is not.
        lambda robot: robot.motion.move_circular(pose(robot, z=0.19, x=0.05), pose(robot, x=0.1), 0.1),
        lambda robot: robot.motion.path([urlink.Linear(pose(robot, x=0.05)), urlink.Linear(pose(robot, y=0.3))]),
        lambda robot: robot.motion.speed_linear([0, 0, 0.1, 0, 0, 0], duration=3.0),
        lambda robot: robot.motion.speed_joints([0, -0.1, 0, 0, 0, 0], duration=4.0),
        # The tool would reach the face only while it brakes.
        lambda robot: robot.motion.speed_linear([0, 0, 0.2, 0, 0, 0], 0.25, duration=0.9),
        lambda robot: robot.motion.until_contact([0, 0, -1], distance=0.2),
        lambda robot: robot.motion.follow(Trajectory.from_arrays([0, 4, 8], [READY, at(0, -0.5, 0, 0, 0, 0), READY])),
    ],
    "tool_speed": [
        lambda robot: robot.motion.move_linear(pose(robot, x=0.1), speed=0.3, acceleration=2.0),
        lambda robot: robot.motion.move_joints(at(0.3, 0, 0, 0, 0, 0), speed=0.9),
        lambda robot: robot.motion.move_joints(at(0.3, 0, 0, 0, 0, 0), time=0.5),
        lambda robot: robot.motion.speed_linear([0.2, 0.2, 0, 0, 0, 0], duration=0.5),
        lambda robot: robot.motion.follow(Trajectory.from_arrays([0, 0.4], [READY, at(0.2, 0, 0, 0, 0, 0)])),
    ],
    "joint_speed": [
        lambda robot: robot.motion.move_joints(at(0, 0, 0, 0, 0, 1.0), speed=1.2),
        lambda robot: robot.motion.speed_joints([0, 0, 0, 0, 0, 1.2], 10.0, duration=0.5),
        lambda robot: robot.motion.servo(target_filter="jerk_limited", speed=1.5),
    ],
    "allowed": [
        lambda robot: robot.script.run("textmsg(1)"),
        lambda robot: robot.script.send_line("set speed 1"),
        lambda robot: robot.dashboard.play(),
        lambda robot: robot.dashboard.send("play"),
        lambda robot: robot.dashboard.send("load x.urp"),
        lambda robot: robot.freedrive(),
        lambda robot: robot.motion.force_mode("base", [0, 0, 1, 0, 0, 0], [0.0] * 6, [0.05] * 6),
    ],
    "speed_slider": [
        lambda robot: robot.set_speed_slider(0.8),
        lambda robot: robot.rtde.inputs("speed_slider_fraction").send(speed_slider_fraction=0.8),
    ],
    "start": [
        lambda robot: robot.set_tcp([0, 0, 0.1, 0, 0, 0], confirm=None),
    ],
}


@pytest.mark.parametrize("limit", BEYOND)
def test_commands_beyond_a_limit_are_not_sent(limit: str, sent: list[str]) -> None:
    with limited(speed_slider=0.5) as robot:
        sent.clear()
        for command in BEYOND[limit]:
            with pytest.raises(LimitExceeded) as caught:
                command(robot)
            assert caught.value.limit == limit
        assert not sent


def test_commands_within_the_limits_are_sent() -> None:
    with limited(speed_slider=0.5) as robot:
        motion = robot.motion
        motion.move_linear(pose(robot, x=0.1), speed=0.25).wait(TIMEOUT)
        motion.move_joints(READY, time=2.0).wait(TIMEOUT)
        motion.path([urlink.Linear(pose(robot, x=0.1), blend=0.02), urlink.Joint(READY)], joint_speed=0.3).wait(TIMEOUT)
        motion.speed_linear([0, 0, 0.05, 0, 0, 0], duration=0.5).wait(TIMEOUT)
        motion.speed_joints([0, 0, 0, 0, 0, 0.5], duration=1.0).wait(TIMEOUT)
        robot.set_speed_slider(0.4)
        robot.dashboard.send("robotmode")
        robot.dashboard.stop()


def test_moves_are_refused_while_the_arm_moves() -> None:
    with limited() as robot:
        motion = robot.motion.move_linear(pose(robot, x=0.1), speed=0.05)
        robot.realtime.wait_until(lambda state: bool(np.abs(state.qd_target).max() > 0.02), TIMEOUT)
        with pytest.raises(LimitExceeded, match="moving"):
            robot.motion.move_joints(READY, speed=0.1)
        assert not motion.done
        robot.motion.stop(wait=TIMEOUT)


def test_moves_are_refused_when_the_tool_is_outside() -> None:
    box = ((-0.6, -0.3, 0.35), (-0.3, 0.1, 0.6))
    with (
        urlink.connect("sim://ur5?firmware=3.15", limits=SessionLimits(box=box)) as robot,
        pytest.raises(LimitExceeded, match="before the motion"),
    ):
        robot.motion.move_joints(at(0, 0, 0, 0, 0, 0.1))


def test_path_is_slower_next_to_a_blend_if_necessary(monkeypatch: pytest.MonkeyPatch) -> None:
    bodies: list[str] = []
    start = Programs.start

    def noting(programs: Programs, wrapped: Any, life: Any, **how: Any) -> None:
        bodies.append(wrapped.text)
        start(programs, wrapped, life, **how)

    with limited() as robot:
        monkeypatch.setattr(Programs, "start", noting)
        fastest = Fastest(robot)
        # Next to the blend, the tool might move at 0.267 m/s. Without the blend, it would reach 0.19 m/s.
        far = [urlink.Joint(at(0.15, 0, 0, 0, 0, 0), blend=0.02), urlink.Joint(at(0.3, 0, 0, 0, 0, 0))]
        robot.motion.path(far, joint_speed=0.6, joint_acceleration=1.0).wait(TIMEOUT)
        assert 0.15 < fastest.tool < 0.25
        assert bodies[0].count("v=0.51") == 2
        with pytest.raises(LimitExceeded) as caught:
            robot.motion.path(far, joint_speed=0.9, joint_acceleration=5.0)
        assert caught.value.limit == "tool_speed"


def test_is_beyond_leaves_out_zones_about_both_ends() -> None:
    with limited() as robot:
        arm = robot.motion._context.limited()
        assert arm is not None
        rows = READY + np.linspace(0.0, 0.4, 41)[:, np.newaxis] * np.eye(6)[0]
        places = robot.kinematics.forward(rows)[:, :3]
        beyond = arm.is_beyond(rows, (0.05, 0.1))
        assert 0.05 <= np.linalg.norm(places[beyond][0] - places[0]) < 0.06
        assert 0.1 <= np.linalg.norm(places[beyond][-1] - places[-1]) < 0.11
        assert arm.is_beyond(rows, (0.0, 0.0)).all()


def lift(robot: Robot, q: FloatArray) -> None:
    """Lift the tool by set-points, slowly at first."""
    begin = float(q[1])
    with robot.motion.servo() as servo:
        for _ in robot.realtime:
            q[1] -= min(0.002, 0.02 * (begin - q[1]) + 1e-4)
            servo.send(q)


def jog_upwards(robot: Robot, frame: Any) -> None:
    """Jog upwards until the session refuses it."""
    with robot.motion.jog(frame) as jog:
        for _ in range(40):
            jog.move([0, 0, 0.1 if frame == "base" else -0.1, 0, 0, 0])
            clock.sleep(0.1)


def test_servo_refuses_a_setpoint_from_which_it_cannot_brake() -> None:
    with limited() as robot:
        begin = robot.realtime.wait().q_target
        with pytest.raises(LimitExceeded):
            lift(robot, begin.copy())
        robot.realtime.wait_until(lambda state: not state.qd_target.any(), TIMEOUT)
        top = robot.kinematics.forward(robot.realtime.wait().q_target)[2]
        assert 0.35 < top < BOX[1][2]


def test_servo_refuses_targets_and_waypoints_outside() -> None:
    outside = at(0, -0.5, 0, 0, 0, 0)
    with limited() as robot:
        with pytest.raises(LimitExceeded), robot.motion.servo(target_filter="jerk_limited", speed=0.2) as servo:
            servo.send(outside)
        with pytest.raises(LimitExceeded), robot.motion.servo() as servo:
            servo.schedule(outside, robot.realtime.wait().time + 5.0)


def test_stream_refuses_points_outside_and_braking_outside() -> None:
    with limited() as robot, robot.motion.stream() as stream:
        begin = robot.realtime.wait().q_target
        stream.append(TrajectoryPoint(begin, 0.0))
        with pytest.raises(LimitExceeded, match="box"):
            stream.append(TrajectoryPoint(begin + np.array([0, -0.5, 0, 0, 0, 0]), 5.0))
        with pytest.raises(LimitExceeded, match="point 0"):
            stream.append(TrajectoryPoint(begin + np.array([0.3, 0, 0, 0, 0, 0]), 0.5))
        stream.append(TrajectoryPoint(begin + np.array([0.1, 0, 0, 0, 0, 0]), 1.0))
        stream.wait_until_dry(TIMEOUT)


def test_jog_stops_within_the_box() -> None:
    with limited() as robot:
        for frame in ("base", "tool"):
            with pytest.raises(LimitExceeded):
                jog_upwards(robot, frame)
            robot.realtime.wait_until(lambda state: not state.qd_target.any(), TIMEOUT)
            z = float(robot.realtime.wait().tool_vector_actual[2])
            assert 0.36 < z < BOX[1][2]


def test_force_mode_ends_before_the_box_ends() -> None:
    with limited("sim://ur5e?firmware=5.11", allowed=KINDS) as robot:
        robot.zero_force_sensor()
        with (
            robot.motion.force_mode("base", [0, 0, 1, 0, 0, 0], [0, 0, 30, 0, 0, 0], [0.1] * 6) as pressing,
            pytest.raises(LimitExceeded, match="box"),
        ):
            pressing.wait(TIMEOUT)
        robot.realtime.wait_until(lambda state: not state.qd_target.any(), TIMEOUT)
        assert 0.36 < robot.realtime.wait().tool_vector_actual[2] < BOX[1][2]


def test_force_mode_is_as_slow_as_the_session() -> None:
    with limited("sim://ur5e?firmware=5.11", allowed=KINDS, tool_speed=0.05) as robot:
        robot.zero_force_sensor()
        fastest = Fastest(robot)
        push = [-60, -60, 0, 0, 0, 0]
        with (
            robot.motion.force_mode("base", [1, 1, 0, 0, 0, 0], push, [0.2] * 6) as pressing,
            pytest.raises(urlink.LinkTimeout),
        ):
            pressing.wait(1.5)
        assert 0.04 < fastest.tool < 0.05


def is_near(q: FloatArray, state: urlink.packets.RealtimeState) -> bool:
    """Whether the arm is near these positions of the joints."""
    return bool(np.abs(state.q_actual - q).max() < 0.05)


def test_impedance_is_as_slow_as_the_session() -> None:
    with limited("sim://ur5e?firmware=5.25", allowed=KINDS, joint_speed=0.3) as robot:
        fastest = Fastest(robot)
        with robot.motion.impedance(speed=2.0) as soft:
            # The base would move the tool at more than 0.25 m/s.
            for q in (at(0, 0, 0, 0, 0, 0.3), at(0.3, 0, 0, 0, 0, 0.3), READY):
                soft.send(q)
                robot.realtime.wait_until(partial(is_near, q), TIMEOUT)
            with pytest.raises(LimitExceeded, match="box"):
                soft.send(at(1.2, 0, 0, 0, 0, 0))
        assert 0.1 < fastest.tool < 0.25
        assert 0.15 < fastest.joint < 0.3


def test_jog_brakes_at_the_box_and_moves_back() -> None:
    with limited() as robot, robot.motion.jog("base", timeout=60.0) as jog:
        jog.move([0, 0, 0.1, 0, 0, 0])
        robot.realtime.wait_until(lambda state: jog.limit is not None and not state.qd_target.any(), TIMEOUT)
        reached = jog.limit
        assert reached is not None
        assert reached.limit == "box"
        z = float(robot.realtime.wait().tool_vector_actual[2])
        # The watch brakes as late as it can: the arm rests less than 1 cm below the face.
        assert BOX[1][2] - 0.01 < z < BOX[1][2]

        def creep() -> None:
            while True:  # each call moves the arm closer to the face
                jog.move([0, 0, 0.1, 0, 0, 0])
                robot.realtime.wait_until(lambda state: jog.limit is not None and not state.qd_target.any(), TIMEOUT)

        with pytest.raises(LimitExceeded, match="z = "):
            creep()
        assert robot.realtime.wait().tool_vector_actual[2] < BOX[1][2]
        jog.move([0, 0, -0.1, 0, 0, 0])
        assert jog.limit is None
        robot.realtime.wait_until(lambda state: state.tool_vector_actual[2] < z - 0.05, TIMEOUT)


@pytest.mark.parametrize(("kind", "speeds"), [("speed_linear", [0, 0, 0.1]), ("speed_joints", [0, -0.2, 0])])
def test_speed_ends_with_error_before_the_box_ends(kind: str, speeds: list[float]) -> None:
    with limited() as robot:

        def lift_on() -> None:
            while True:
                getattr(robot.motion, kind)([*speeds, 0, 0, 0], duration=0.3, wait=TIMEOUT)

        with pytest.raises(LimitExceeded, match="z = "):
            lift_on()
        robot.realtime.wait_until(lambda state: not state.qd_target.any(), TIMEOUT)
        assert BOX[1][2] - 0.03 < robot.realtime.wait().tool_vector_actual[2] < BOX[1][2]


def test_listed_calls_are_sent_without_a_check() -> None:
    with limited(allowed=KINDS) as robot:
        robot.script.run("textmsg(1)", wait=TIMEOUT)
        robot.script.send_line("textmsg(2)")


def test_interpreter_is_refused_unless_it_is_listed() -> None:
    with limited("sim://ur5e?firmware=5.11") as robot, pytest.raises(LimitExceeded, match=r"interpreter\.execute"):
        robot.interpreter()


def test_set_tcp_is_refused_during_a_motion() -> None:
    with limited() as robot:
        robot.set_tcp([0, 0, 0.02, 0, 0, 0])
        robot.motion.move_linear(pose(robot, x=0.1), speed=0.05)
        with pytest.raises(LimitExceeded, match="TCP"):
            robot.set_tcp([0, 0, 0.1, 0, 0, 0])
        robot.motion.stop(wait=TIMEOUT)


def test_group_compares_the_trajectory_of_each_arm() -> None:
    with limited() as left, urlink.connect("sim://ur5?firmware=3.15") as right:
        q = right.realtime.wait().q_target
        group = urlink.Group(left, right)
        with pytest.raises(LimitExceeded):
            group.move_joints([at(0, -0.5, 0, 0, 0, 0), q], speed=0.1)
        group.move_joints([at(0, 0, 0, 0, 0, 0.2), q], speed=0.2).wait(TIMEOUT)


def test_until_contact_counts_the_start_of_its_program() -> None:
    with limited("sim://ur5e?firmware=5.11") as robot:
        # Without the start of the program, the tool would come to rest 5 mm below the face, and with it 6 mm above.
        speed, acceleration = 0.2, 0.5
        distance = BOX[1][2] - pose(robot)[2] - speed**2 / acceleration - 0.01
        with pytest.raises(LimitExceeded, match="z = "):
            robot.motion.until_contact([0, 0, 1], speed, acceleration=acceleration, distance=distance)
        robot.motion.until_contact([0, 0, 1], speed, acceleration=acceleration, distance=distance - 0.01)
        robot.motion.stop(wait=TIMEOUT)


def test_follow_stays_below_limit_after_sudden_acceleration() -> None:
    # Wrist 3 turns at 0.96 rad/s after 0.1 s, and the limit is 1 rad/s. An arm that falls behind would be faster.
    times = np.array([0.0, 0.1, 1.1, 1.2])
    turned = 0.96 * np.array([0.0, 0.05, 1.05, 1.1])
    speeds = np.outer([0.0, 0.96, 0.96, 0.0], np.eye(6)[5])
    trajectory = Trajectory.from_arrays(times, READY + np.outer(turned, np.eye(6)[5]), speeds)
    with limited() as robot:
        fastest = Fastest(robot)
        robot.motion.follow(trajectory).wait(TIMEOUT)
        assert 0.94 < fastest.joint < 1.0


def test_follow_counts_the_speed_at_which_it_catches_up() -> None:
    # The tool is fastest after 0.1 s, at 0.249 m/s. The program has just started, so the arm catches up then, and would
    # move its tool at 0.255 m/s.
    times = [0.0, 0.225, 2.325]
    rows = [
        [0.073, -1.176, 1.637, -1.933, -1.567, 1.047],
        [0.094, -1.249, 1.734, -1.960, -1.570, 1.169],
        [-0.042, -0.936, 1.164, -1.717, -1.665, 1.131],
    ]
    with limited(box=None) as robot:
        robot.motion.move_joints(rows[0], speed=0.2).wait(TIMEOUT)
        fastest = Fastest(robot)
        with pytest.raises(LimitExceeded) as caught:
            robot.motion.follow(Trajectory.from_arrays(times, rows))
        assert caught.value.limit == "tool_speed"
        slower = [1.05 * time for time in times]
        robot.motion.follow(Trajectory.from_arrays(slower, rows)).wait(TIMEOUT)
        assert 0.23 < fastest.tool < 0.25


def test_connect_async_takes_limits() -> None:
    async def main() -> None:
        limits = SessionLimits(tool_speed=0.05)
        async with urlink.connect_async("sim://ur5?firmware=3.15", limits=limits) as robot:
            with pytest.raises(LimitExceeded):
                await robot.motion.move_joints(READY + 0.5, wait=True)
            with pytest.raises(LimitExceeded):
                await robot.script.run("textmsg(1)", wait=True)

    asyncio.run(main())


def test_compat_refuses_motions_and_scripts_of_other_clients() -> None:
    compat = pytest.importorskip("urlink_compat.rtde_control", reason="the package urlink-compat is not installed")
    with compat.RTDEControlInterface("sim://ur5?firmware=3.15", limits=SessionLimits(tool_speed=0.05)) as control:
        with pytest.raises(LimitExceeded):
            control.moveJ(READY + 0.5)
        with pytest.raises(LimitExceeded):
            control.sendCustomScript("textmsg(1)")

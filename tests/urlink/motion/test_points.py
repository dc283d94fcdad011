"""Points by name: teaching, moving, refusals and checks."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Iterator
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import urlink
from linkcore.errors import BadValue, LocalError
from urlink import NoSuchPoint, Point, Unreachable
from urlink.arm import poses
from urlink.arm.kinematics import Arm
from urlink.motion.points.point import configuration, goal_joints, goal_pose, reached
from urlink.robot import Robot

DATE = datetime(2026, 3, 1, 12, tzinfo=timezone.utc)
ARM = Arm("UR5e")
READY = np.array([0.3, -1.5, 2.0, -2.0, -1.5, 0.2])
NO_TCP = np.zeros(6)
LONGER = np.array([0.0, 0.0, 0.1, 0.0, 0.0, 0.0])
TURNED = np.array([0.0, 0.0, 0.0, 0.0, 0.0, math.pi - 0.01])


def taught(q: Any = READY, tcp: Any = NO_TCP, model: str = "UR5e") -> Point:
    """Return a point that was taught on a UR5e at `q`."""
    return Point(q, ARM.forward(q, tcp), tcp, model, DATE)


@pytest.fixture
def robot(tmp_path: Path) -> Iterator[Robot]:
    with urlink.connect("sim://ur5e?firmware=5.11", points=tmp_path / "cell.json") as robot:
        yield robot


# -- the value -----------------------------------------------------------------------------------------


def test_point_is_frozen_and_comparable() -> None:
    point = taught()
    assert point == taught()
    assert hash(point) == hash(taught())
    assert point != taught(READY + 0.1)
    assert point != 5
    assert not point.q.flags.writeable
    assert not point.pose.flags.writeable
    with pytest.raises(AttributeError):
        point.model = "UR3"  # type: ignore[misc]


def test_point_stores_its_date_in_utc() -> None:
    local = datetime.fromisoformat("2026-03-01T14:00:00+02:00")
    assert Point(READY, NO_TCP, NO_TCP, "UR5e", local).date.isoformat() == "2026-03-01T12:00:00+00:00"
    with pytest.raises(BadValue, match=r"date is .*; expected a datetime with a time zone"):
        Point(READY, NO_TCP, NO_TCP, "UR5e", datetime(2026, 3, 1))


# -- goals -------------------------------------------------------------------------------------------


@pytest.mark.property
@given(st.lists(st.floats(-3.1, 3.1), min_size=6, max_size=6))
def test_configuration_is_the_row_of_branches(q: list[float]) -> None:
    given_q = np.array(q)
    away, wrist, elbow = configuration(ARM, given_q)
    rows = ARM.branches(ARM.forward(given_q))
    apart = np.abs(np.remainder(rows - given_q + math.pi, math.tau) - math.pi).max(axis=1)
    if np.nanmin(apart) < 1e-6 and abs(q[2]) > 1e-3 and abs(q[4]) > 1e-3:
        assert apart[4 * away + 2 * wrist + elbow] < 1e-6


@pytest.mark.parametrize("keep", [None, "pose", "joints"])
def test_unchanged_tcp_gives_the_taught_values(keep: Any) -> None:
    point = taught(tcp=LONGER)
    close = LONGER + np.array([5e-5, 0.0, 0.0, 0.0, 0.0, 5e-4])
    assert goal_joints(point, keep, ARM, close).tolist() == point.q.tolist()
    assert goal_pose(point, keep, ARM, close).tolist() == point.pose.tolist()


@pytest.mark.parametrize("tcp", [LONGER, LONGER * 2e-3, TURNED, [0.0, 0.0, 0.0, 0.0, 2e-3, 0.0]])
def test_changed_tcp_is_refused_without_keep(tcp: Any) -> None:
    for goal in (goal_joints, goal_pose):
        with pytest.raises(BadValue, match=r"the TCP has changed by .* taught on 2026-03-01; pass keep='pose'"):
            goal(taught(), None, ARM, np.array(tcp))


@pytest.mark.parametrize("tcp", [LONGER, TURNED])
def test_keep_pose_moves_the_current_tcp_to_the_pose(tcp: Any) -> None:
    point = taught()
    q = goal_joints(point, "pose", ARM, tcp)
    assert ARM.forward(q, tcp) == pytest.approx(point.pose, abs=1e-9)
    assert configuration(ARM, q) == configuration(ARM, point.q)
    assert goal_pose(point, "pose", ARM, tcp).tolist() == point.pose.tolist()


def test_keep_joints_moves_to_the_joints() -> None:
    point = taught()
    assert goal_joints(point, "joints", ARM, LONGER).tolist() == point.q.tolist()
    assert goal_pose(point, "joints", ARM, LONGER) == pytest.approx(ARM.forward(READY, LONGER))


def test_keep_pose_stays_within_the_joint_limits() -> None:
    q = READY.copy()
    q[5] = math.tau - 0.1
    # The new tool turns wrist 3 by -0.5 rad or 0.5 rad; the second leaves the range of the joint.
    for turn in (0.5, -0.5):
        found = reached(taught(q), ARM, np.array([0.0, 0.0, 0.0, 0.0, 0.0, turn]))
        assert abs(found[5]) <= math.tau


def test_pose_out_of_reach_is_refused() -> None:
    point = taught([0.0, -math.pi / 2, 0.01, -math.pi / 2, -1.5, 0.0])
    short = np.array([0.0, 0.0, -0.5, 0.0, 0.0, 0.0])
    for goal in (goal_joints, goal_pose):
        with pytest.raises(Unreachable):
            goal(point, "pose", ARM, short)


def test_flipped_arm_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    point = taught()
    flipped = [
        row for row in ARM.solutions(point.pose, READY, LONGER) if configuration(ARM, row) != configuration(ARM, READY)
    ]
    assert flipped
    monkeypatch.setattr(Arm, "solutions", lambda *arguments: np.array(flipped))
    with pytest.raises(Unreachable, match="only in another configuration of the arm"):
        goal_joints(point, "pose", ARM, LONGER)


def test_point_of_another_model_is_refused() -> None:
    with pytest.raises(BadValue, match="taught on a UR10e, but this arm is a UR5e"):
        goal_joints(taught(model="UR10e"), None, ARM, NO_TCP)
    # A UR7e reports the same robot type as a UR5e.
    assert goal_joints(taught(model="UR7e"), None, ARM, NO_TCP).tolist() == READY.tolist()


@pytest.mark.parametrize("change", [[0.021, 0.0, 0.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 0.0, 0.0, 0.051]])
def test_contradicting_joints_and_pose_are_refused(change: list[float]) -> None:
    point = taught()
    edited = Point(READY, poses.compose(point.pose, change), point.tcp, "UR5e", DATE)
    with pytest.raises(BadValue, match=r"joint positions and the pose of the point differ by \d+\.\d mm"):
        goal_joints(edited, "joints", ARM, NO_TCP)


def test_joint_out_of_its_range_is_refused() -> None:
    with pytest.raises(BadValue, match=r"q\[0\] \(base\) is 7 rad"):
        goal_joints(taught([7.0, *READY[1:]]), None, ARM, NO_TCP)


# -- the robot -----------------------------------------------------------------------------------------


@pytest.mark.simulated_time
def test_connect_without_points_names_the_argument() -> None:
    with urlink.connect("sim://") as robot, pytest.raises(LocalError, match=r"points='cell\.json'"):
        robot.points  # noqa: B018


@pytest.mark.parametrize("points", [5, "", b"cell.json", True])
def test_connect_refuses_an_invalid_points_file(points: Any) -> None:
    with pytest.raises(BadValue, match=r"points=.*; expected the path of a file"):
        urlink.connect("sim://", points=points)


@pytest.mark.slow
@pytest.mark.simulated_time
def test_points_are_taught_found_and_moved_to(robot: Robot, tmp_path: Path) -> None:
    robot.set_tcp(LONGER.tolist())
    start = robot.realtime.wait()
    point = robot.points.teach("start")
    assert point.q == pytest.approx(start.q_actual, abs=1e-3)
    assert point.pose == pytest.approx(start.tool_vector_actual, abs=1e-3)
    assert point.tcp.tolist() == LONGER.tolist()
    assert all(round(each, 9) == each for each in point.q.tolist())
    assert (point.model, point.date.microsecond) == ("UR5e", 0)
    with pytest.raises(BadValue, match="already has a point 'start'"):
        robot.points.teach("start")
    robot.motion.move_joints(READY, wait=True)
    robot.points.teach("ready")
    assert list(robot.points) == list(robot.points.keys()) == ["start", "ready"]
    assert len(robot.points) == 2
    assert dict(robot.points.items()) == dict(zip(robot.points, robot.points.values(), strict=True))
    assert "none" not in robot.points
    assert robot.points.get("none") is None
    robot.motion.move_joints(robot.points["start"], wait=True)
    assert robot.realtime.wait().q_actual == pytest.approx(point.q, abs=1e-3)
    robot.motion.move_linear(robot.points["ready"], wait=True)
    assert robot.realtime.wait().tool_vector_actual == pytest.approx(robot.points["ready"].pose, abs=1e-3)
    # The file serves another robot object too.
    with urlink.connect("sim://ur5e", points=tmp_path / "cell.json", read_only=True) as other:
        assert other.points["start"] == point
        assert other.points.remove("ready").model == "UR5e"
    assert list(robot.points) == ["start"]


@pytest.mark.slow
@pytest.mark.simulated_time
def test_moves_after_a_tcp_change_need_keep(robot: Robot) -> None:
    point = robot.points.teach("start")
    robot.set_tcp(LONGER.tolist())
    for move in (robot.motion.move_joints, robot.motion.move_linear):
        with pytest.raises(BadValue, match=r"the TCP has changed by 100\.0 mm"):
            move(point)
        with pytest.raises(BadValue, match="keep='tool'; expected 'pose' or 'joints'"):
            move(point, keep="tool")  # type: ignore[arg-type]
        assert robot.motion.current is None
    robot.motion.move_joints(point, keep="pose", wait=True)
    assert robot.realtime.wait().tool_vector_actual == pytest.approx(point.pose, abs=1e-3)
    robot.motion.move_linear(point, keep="joints", wait=True)
    assert robot.realtime.wait().q_actual == pytest.approx(point.q, abs=1e-3)


@pytest.mark.simulated_time
def test_keep_is_refused_for_numbers(robot: Robot) -> None:
    with pytest.raises(BadValue, match="keep='pose' applies only to a point"):
        robot.motion.move_joints(READY, keep="pose")
    with pytest.raises(BadValue, match="keep='joints' applies only to a point"):
        robot.motion.move_linear(ARM.forward(READY), keep="joints")


@pytest.mark.simulated_time
def test_point_of_another_arm_moves_nothing(robot: Robot) -> None:
    robot.points.add("other", taught(model="UR3e"))
    with pytest.raises(BadValue, match="taught on a UR3e, but this arm is a UR5e"):
        robot.motion.move_joints(robot.points["other"])
    assert robot.motion.current is None
    with pytest.raises(BadValue, match=r"point is 5; expected a urlink\.Point"):
        robot.points.add("other", 5)  # type: ignore[arg-type]


@pytest.mark.simulated_time
def test_check_reports_each_verdict(robot: Robot) -> None:
    robot.points.add("same", taught(tcp=LONGER))
    robot.points.add("changed", taught())
    robot.points.add("far", taught([0.0, -math.pi / 2, 0.01, -math.pi / 2, -1.5, 0.0], [0.0, 0.0, 0.6, 0.0, 0.0, 0.0]))
    robot.points.add("other", taught(model="UR3e"))
    robot.set_tcp(LONGER.tolist())
    checks = {check.name: check for check in robot.points.check_all()}
    assert {name: check.verdict for name, check in checks.items()} == {
        "same": "unchanged",
        "changed": "reachable",
        "far": "unreachable",
        "other": "refused",
    }
    assert [check.is_reachable for check in checks.values()] == [True, True, False, False]
    changed = checks["changed"]
    assert changed.moved == pytest.approx(0.1)
    assert changed.q is not None
    assert ARM.forward(changed.q, LONGER) == pytest.approx(taught().pose, abs=1e-9)
    assert changed.largest == pytest.approx(np.abs(changed.q - READY).max())
    assert "reaches" in checks["far"].reason
    assert "UR3e" in checks["other"].reason
    assert robot.points.check("same").verdict == "unchanged"
    with pytest.raises(NoSuchPoint):
        robot.points.check("none")


@pytest.mark.simulated_time
def test_asyncio_robot_teaches_and_moves_to_points(tmp_path: Path) -> None:
    async def work() -> None:
        async with urlink.connect_async("sim://ur5e", points=tmp_path / "cell.json") as robot:
            point = await robot.points.teach("start")
            assert robot.points["start"] == point
            assert "start" in robot.points
            assert list(robot.points) == ["start"]
            assert len(robot.points) == 1
            assert (await robot.points.check("start")).verdict == "unchanged"
            await robot.motion.move_joints(point, wait=True)
            with pytest.raises(NoSuchPoint):
                robot.points["none"]

    asyncio.run(work())

"""speedj, speedl, stopj, stopl."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from linkcore.errors import BadValue
from tests.urlink.simulator.drive.stepping import (
    CYCLE,
    REST,
    UR5E,
    check_continuous,
    cycles,
    finish,
    positions,
    speeds,
    standing,
    to_rest,
)
from urlink.simulator import kinematics
from urlink.simulator.drive import LimitViolation, Move
from urlink.simulator.motion import HOME
from urlink.simulator.twist import geometry, tool_speed


def test_joints_speed_up_in_proportion_and_keep_their_speed() -> None:
    drive = standing()
    wanted = [0.5, -0.25, 0.0, 0.1, 0.0, 1.0]
    setpoints = finish(drive, drive.speedj(wanted, 2.0, None))
    assert len(setpoints) == pytest.approx(0.5 / CYCLE, abs=1)
    assert drive.setpoint.qd == wanted
    np.testing.assert_allclose(speeds(setpoints)[:, 0], 0.5 * speeds(setpoints)[:, 5], atol=1e-12)
    after = cycles(drive, 100)
    assert (speeds(after) == wanted).all()
    assert not drive.is_standing
    check_continuous(setpoints[0], setpoints[1:] + after, np.full(6, 2.0))


def test_a_time_ends_the_function_and_not_the_speed() -> None:
    drive = standing()
    assert len(finish(drive, drive.speedj([0.1] * 6, 10.0, 0.1))) == 50
    assert len(finish(drive, drive.speedl([0.01] * 6, 1.0, 0.008, 1.0))) == 4
    assert len(finish(drive, drive.speedj([0.5] * 6, 0.1, 0.008))) == 4
    assert len(finish(drive, drive.speedj([0.5] * 6, 0.1, 0.0))) == 1
    assert not drive.is_standing


def test_a_speed_follows_a_speed_without_a_stop() -> None:
    drive = standing()
    finish(drive, drive.speedj([0.5] * 6, 2.0, None))
    setpoints = finish(drive, drive.speedj([0.7, 0.3, 0.5, 0.5, 0.5, 0.5], 1.0, None))
    assert speeds(setpoints).min() >= 0.3 - 1e-12
    assert drive.setpoint.qd == [0.7, 0.3, 0.5, 0.5, 0.5, 0.5]


def test_stopj_brakes_evenly_to_rest() -> None:
    drive = standing()
    finish(drive, drive.speedj([1.0, 0.5, 0, 0, 0, 0], 5.0, None))
    before = drive.setpoint
    setpoints = finish(drive, drive.stopj(2.0))
    assert len(setpoints) == pytest.approx(0.5 / CYCLE, abs=1)
    assert drive.setpoint.qd == REST
    assert drive.is_standing
    check_continuous(before, setpoints, np.full(6, 2.0))
    assert positions(setpoints)[-1, 0] - before.q[0] == pytest.approx(0.25, abs=1e-9)


def test_no_stop_is_harder_than_the_model() -> None:
    drive = standing()
    finish(drive, drive.speedj([1.0] * 6, 5.0, None))
    assert len(finish(drive, drive.stopj(1e6))) == pytest.approx(1.0 / 40.0 / CYCLE, abs=1)


def test_the_tool_keeps_its_speed_on_a_line() -> None:
    drive = standing()
    drive.tcp = [0.0, 0.0, 0.1, 0.0, 0.0, 0.0]
    wanted = [0.1, -0.05, 0.05, 0.0, 0.1, 0.2]
    before = drive.setpoint
    setpoints = finish(drive, drive.speedl(wanted, 0.5, None, 1.0))
    assert len(setpoints) == pytest.approx(float(np.linalg.norm(wanted[:3])) / 0.5 / CYCLE, abs=1)
    setpoints += cycles(drive, 300)
    pose = kinematics.pose(UR5E, drive.setpoint.q, drive.tcp)
    reached = tool_speed(geometry(UR5E), drive.setpoint.q, drive.setpoint.qd, pose.tolist())
    np.testing.assert_allclose(reached, wanted, atol=1e-3)
    setpoints += finish(drive, drive.stopl(0.5, 1.0))
    assert drive.setpoint.qd == REST
    assert drive.is_standing
    check_continuous(before, setpoints, UR5E.max_acceleration)
    path = np.array([kinematics.pose(UR5E, setpoint.q, drive.tcp)[:3] for setpoint in setpoints])
    direction = np.array(wanted[:3]) / np.linalg.norm(wanted[:3])
    across = (path - path[0]) - np.outer((path - path[0]) @ direction, direction)
    assert np.abs(across).max() < 1e-6


def test_stopl_takes_over_joints_that_move() -> None:
    drive = standing()
    drive.speedj([0.3, 0.2, -0.3, 0.1, 0.1, 0.5], 3.0, None)
    before = drive.setpoint
    setpoints = cycles(drive, 200)
    setpoints += finish(drive, drive.stopl(1.0, 3.0))
    assert drive.is_standing
    check_continuous(before, setpoints, UR5E.max_acceleration)


def test_where_the_line_ends_stopl_brakes_the_joints() -> None:
    """A nearly stretched arm that moves outward has not the way to stop on its line."""
    drive = standing([0.0, -0.3, 0.2, -1.5, -1.5, 0.0])
    drive.speedl([0.1, 0, 0, 0, 0, 0], 5.0, None, 5.0)
    cycles(drive, 30)
    before = drive.setpoint
    setpoints = finish(drive, drive.stopl(0.02, 0.02))
    assert drive.is_standing
    check_continuous(before, setpoints, 3.0 * UR5E.max_acceleration)


def test_a_line_out_of_reach_is_a_violation() -> None:
    drive = standing()
    drive.speedl([0.5, 0, 0, 0, 0, 0], 5.0, None, 5.0)
    with pytest.raises(LimitViolation):
        cycles(drive, 5000)


def test_a_joint_that_leaves_its_range_is_a_violation_and_may_come_back() -> None:
    drive = standing([6.2, *HOME[1:]])
    drive.speedj([1.0, 0, 0, 0, 0, 0], 5.0, None)
    with pytest.raises(LimitViolation, match=r"base: a position of .* out of range"):
        cycles(drive, 200)
    assert drive.setpoint.q[0] <= UR5E.position_limits[0, 1]
    # Whatever stops the arm now needs some way beyond.
    drive.start([6.4, *drive.setpoint.q[1:]])
    drive.speedj([-0.5, 0, 0, 0, 0, 0], 5.0, None)
    cycles(drive, 500)
    assert drive.setpoint.q[0] < 6.2


def test_a_speed_above_the_limit_is_a_violation() -> None:
    drive = standing()
    drive.speedj([0, 0, 0, 0, 0, 4.0], 10.0, None)
    with pytest.raises(LimitViolation, match="wrist 3: a speed of"):
        cycles(drive, 500)


def test_arguments_without_meaning() -> None:
    drive = standing()
    wrongs: list[Callable[[], Move]] = [
        lambda: drive.speedj([0.0] * 5, 1.0, None),
        lambda: drive.speedj([0.0] * 6, 0.0, None),
        lambda: drive.speedj([0.1] * 6, 1.0, -1.0),
        lambda: drive.speedl([0.0] * 6, -1.0, None, 1.0),
        lambda: drive.speedl([0.0] * 6, 1.0, float("nan"), 1.0),
        lambda: drive.stopj(0.0),
        lambda: drive.stopl(float("inf"), 1.0),
        lambda: drive.stopl(1.0, -1.0),
    ]
    for wrong in wrongs:
        with pytest.raises(BadValue):
            wrong()


def test_speeds_come_to_rest_when_nobody_commands() -> None:
    for begin in ("speedj", "speedl"):
        drive = standing()
        before = drive.setpoint
        move = drive.speedj([0.5] * 6, 5.0, None) if begin == "speedj" else drive.speedl([0.05] * 6, 1.0, None, 1.0)
        setpoints = cycles(drive, 200)
        drive.release()
        assert move.is_over
        setpoints += to_rest(drive)
        check_continuous(before, setpoints, UR5E.max_acceleration)

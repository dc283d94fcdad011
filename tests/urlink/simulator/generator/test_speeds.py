"""speedj, speedl, stopj, stopl."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from linkcore.errors import BadValue
from tests.urlink.simulator.generator.stepping import (
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
from urlink.arm.kinematics import Arm
from urlink.simulator.robot.generator import Command, LimitViolation
from urlink.simulator.robot.setpoint_sources import HOME


def test_speedj_accelerates_joints_in_proportion() -> None:
    generator = standing()
    wanted = [0.5, -0.25, 0.0, 0.1, 0.0, 1.0]
    setpoints = finish(generator, generator.speedj(wanted, 2.0, None))
    assert len(setpoints) == pytest.approx(0.5 / CYCLE, abs=1)
    assert generator.setpoint.qd == wanted
    np.testing.assert_allclose(speeds(setpoints)[:, 0], 0.5 * speeds(setpoints)[:, 5], atol=1e-12)
    after = cycles(generator, 100)
    assert (speeds(after) == wanted).all()
    assert not generator.is_standing
    check_continuous(setpoints[0], setpoints[1:] + after, np.full(6, 2.0))


def test_time_ends_the_command_but_not_the_speed() -> None:
    generator = standing()
    assert len(finish(generator, generator.speedj([0.1] * 6, 10.0, 0.1))) == 50
    assert len(finish(generator, generator.speedl([0.01] * 6, 1.0, 0.008, 1.0))) == 4
    assert len(finish(generator, generator.speedj([0.5] * 6, 0.1, 0.008))) == 4
    assert len(finish(generator, generator.speedj([0.5] * 6, 0.1, 0.0))) == 1
    assert not generator.is_standing


def test_slider_stretches_the_time_of_a_speed_command() -> None:
    generator = standing()
    generator.speed_fraction = 0.25
    finish(generator, generator.speedj([0.0] * 6, 1.0, 0.1))
    before = generator.setpoint.q[5]
    for _ in range(100):
        assert len(finish(generator, generator.speedj([0, 0, 0, 0, 0, 0.2], 100.0, CYCLE))) == 4
    assert generator.setpoint.q[5] - before == pytest.approx(100 * CYCLE * 0.2, rel=0.01)
    assert len(finish(generator, generator.speedl([0, 0, 0.01, 0, 0, 0], 1.0, 0.1, 1.0))) == 200
    generator.speed_fraction = 0.0
    cycles(generator, 100)
    move = generator.speedj([0, 0, 0, 0, 0, 0.2], 100.0, CYCLE)
    cycles(generator, 1000)
    assert not move.is_over


def test_speedj_changes_speed_without_stopping() -> None:
    generator = standing()
    finish(generator, generator.speedj([0.5] * 6, 2.0, None))
    setpoints = finish(generator, generator.speedj([0.7, 0.3, 0.5, 0.5, 0.5, 0.5], 1.0, None))
    assert speeds(setpoints).min() >= 0.3 - 1e-12
    assert generator.setpoint.qd == [0.7, 0.3, 0.5, 0.5, 0.5, 0.5]


def test_stopj_brakes_evenly_to_rest() -> None:
    generator = standing()
    finish(generator, generator.speedj([1.0, 0.5, 0, 0, 0, 0], 5.0, None))
    before = generator.setpoint
    setpoints = finish(generator, generator.stopj(2.0))
    assert len(setpoints) == pytest.approx(0.5 / CYCLE, abs=1)
    assert generator.setpoint.qd == REST
    assert generator.is_standing
    check_continuous(before, setpoints, np.full(6, 2.0))
    assert positions(setpoints)[-1, 0] - before.q[0] == pytest.approx(0.25, abs=1e-9)


def test_stopj_is_limited_by_the_model() -> None:
    generator = standing()
    finish(generator, generator.speedj([1.0] * 6, 5.0, None))
    assert len(finish(generator, generator.stopj(1e6))) == pytest.approx(1.0 / 40.0 / CYCLE, abs=1)


def test_speedl_keeps_tool_speed_on_a_line() -> None:
    generator = standing()
    generator.tcp = [0.0, 0.0, 0.1, 0.0, 0.0, 0.0]
    wanted = [0.1, -0.05, 0.05, 0.0, 0.1, 0.2]
    before = generator.setpoint
    setpoints = finish(generator, generator.speedl(wanted, 0.5, None, 1.0))
    assert len(setpoints) == pytest.approx(float(np.linalg.norm(wanted[:3])) / 0.5 / CYCLE, abs=1)
    setpoints += cycles(generator, 300)
    reached = Arm(UR5E).velocity(generator.setpoint.q, generator.setpoint.qd, generator.tcp)
    np.testing.assert_allclose(reached, wanted, atol=1e-3)
    setpoints += finish(generator, generator.stopl(0.5, 1.0))
    assert generator.setpoint.qd == REST
    assert generator.is_standing
    check_continuous(before, setpoints, UR5E.max_acceleration)
    path = np.array([Arm(UR5E).forward(setpoint.q, generator.tcp)[:3] for setpoint in setpoints])
    direction = np.array(wanted[:3]) / np.linalg.norm(wanted[:3])
    across = (path - path[0]) - np.outer((path - path[0]) @ direction, direction)
    assert np.abs(across).max() < 1e-6


def test_stopl_takes_over_moving_joints() -> None:
    generator = standing()
    generator.speedj([0.3, 0.2, -0.3, 0.1, 0.1, 0.5], 3.0, None)
    before = generator.setpoint
    setpoints = cycles(generator, 200)
    setpoints += finish(generator, generator.stopl(1.0, 3.0))
    assert generator.is_standing
    check_continuous(before, setpoints, UR5E.max_acceleration)


def test_stopl_brakes_the_joints_where_its_line_ends() -> None:
    """A nearly stretched arm that moves outwards has too little distance to stop on its line."""
    generator = standing([0.0, -0.3, 0.2, -1.5, -1.5, 0.0])
    generator.speedl([0.1, 0, 0, 0, 0, 0], 5.0, None, 5.0)
    cycles(generator, 30)
    before = generator.setpoint
    setpoints = finish(generator, generator.stopl(0.02, 0.02))
    assert generator.is_standing
    check_continuous(before, setpoints, 3.0 * UR5E.max_acceleration)


def test_speedl_out_of_reach_raises_limit_violation() -> None:
    generator = standing()
    generator.speedl([0.5, 0, 0, 0, 0, 0], 5.0, None, 5.0)
    with pytest.raises(LimitViolation):
        cycles(generator, 5000)


def test_joint_that_leaves_its_range_may_return() -> None:
    generator = standing([6.2, *HOME[1:]])
    generator.speedj([1.0, 0, 0, 0, 0, 0], 5.0, None)
    with pytest.raises(LimitViolation, match=r"base: a position of .* out of range"):
        cycles(generator, 200)
    assert generator.setpoint.q[0] <= UR5E.position_limits[0, 1]
    # The braking arm travels beyond the limit.
    generator.start([6.4, *generator.setpoint.q[1:]])
    generator.speedj([-0.5, 0, 0, 0, 0, 0], 5.0, None)
    cycles(generator, 500)
    assert generator.setpoint.q[0] < 6.2


def test_speed_above_the_limit_raises_limit_violation() -> None:
    generator = standing()
    generator.speedj([0, 0, 0, 0, 0, 4.0], 10.0, None)
    with pytest.raises(LimitViolation, match="wrist 3: a speed of"):
        cycles(generator, 500)


def test_speed_commands_reject_invalid_arguments() -> None:
    generator = standing()
    wrongs: list[Callable[[], Command]] = [
        lambda: generator.speedj([0.0] * 5, 1.0, None),
        lambda: generator.speedj([0.0] * 6, 0.0, None),
        lambda: generator.speedj([0.1] * 6, 1.0, -1.0),
        lambda: generator.speedl([0.0] * 6, -1.0, None, 1.0),
        lambda: generator.speedl([0.0] * 6, 1.0, float("nan"), 1.0),
        lambda: generator.stopj(0.0),
        lambda: generator.stopl(float("inf"), 1.0),
        lambda: generator.stopl(1.0, -1.0),
    ]
    for wrong in wrongs:
        with pytest.raises(BadValue):
            wrong()


def test_release_brakes_speed_commands_to_rest() -> None:
    for begin in ("speedj", "speedl"):
        generator = standing()
        before = generator.setpoint
        move = (
            generator.speedj([0.5] * 6, 5.0, None)
            if begin == "speedj"
            else generator.speedl([0.05] * 6, 1.0, None, 1.0)
        )
        setpoints = cycles(generator, 200)
        generator.release()
        assert move.is_over
        setpoints += to_rest(generator)
        check_continuous(before, setpoints, UR5E.max_acceleration)

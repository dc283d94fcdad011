"""servoj: following a stream of set-points."""

from __future__ import annotations

import math
from contextlib import nullcontext

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

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
from urlink.simulator.robot.generator import LimitViolation, MotionGenerator
from urlink.simulator.robot.generator.streamed_motion import lag_of
from urlink.simulator.robot.setpoint_sources import HOME, Setpoint

#: lookahead_time and gain; the last entry is for firmware that has neither
ARGUMENTS = [(0.03, 300.0), (0.1, 300.0), (0.03, 2000.0), (0.2, 100.0), (0.0, 0.0)]


def waving(time: float) -> list[float]:
    """Return joint positions that start at rest and move at up to 0.5 rad/s."""
    return [h + 0.25 * (1.0 - math.cos(2.0 * time)) for h in HOME]


@pytest.mark.parametrize("cycle", [0.002, 0.008])
@pytest.mark.parametrize(("lookahead", "gain"), ARGUMENTS)
def test_arm_follows_a_wave_with_the_documented_lag(lookahead: float, gain: float, cycle: float) -> None:
    generator = standing()
    lag = lag_of(cycle, lookahead, gain)
    before, setpoints, expected = generator.setpoint, [], []
    for i in range(1, int(4.0 / cycle)):
        generator.servoj(waving(i * cycle), cycle, lookahead, gain)
        setpoints.append(generator.advance(cycle))
        expected.append(waving(max(i * cycle - lag, 0.0)))
    # The delay omits the second order: a quarter of the squared lag times an acceleration of 1 rad/s².
    assert np.abs(positions(setpoints) - expected).max() < 0.6 * lag**2 + 1e-4
    check_continuous(before, setpoints, UR5E.max_acceleration, cycle)


def test_servoj_lag_of_common_driver_settings_is_as_documented() -> None:
    assert lag_of(0.008, 0.03, 300.0) == pytest.approx(0.0337, abs=1e-4)
    assert lag_of(0.008, 0.0, 0.0) == 0.008


@pytest.mark.parametrize(("lookahead", "gain"), ARGUMENTS)
def test_small_step_is_reached_exactly_without_overshoot(lookahead: float, gain: float) -> None:
    generator = standing()
    target = [h + 0.0004 for h in HOME]
    generator.servoj(target, CYCLE, lookahead, gain)
    way = positions(cycles(generator, 2000))
    assert (np.diff(way, axis=0) >= -1e-12).all()
    assert way.max(axis=0).tolist() == target
    assert generator.is_standing
    assert generator.setpoint == (target, REST, REST)


def test_servoj_ends_after_a_cycle_or_its_time() -> None:
    generator = standing()
    for seconds, count in ((0.0, 1), (0.002, 1), (0.008, 4), (0.1, 50)):
        assert len(finish(generator, generator.servoj(list(HOME), seconds, 0.03, 300.0))) == count


def test_set_point_of_several_cycles_is_approached_evenly() -> None:
    """Set-points every 8 ms, at 500 cycles per second, must cause no ripple in the speed."""
    generator = standing()
    setpoints = []
    for i in range(1, 250):
        setpoints += finish(generator, generator.servoj([HOME[0] + 0.004 * i, *HOME[1:]], 0.008, 0.03, 300.0))
    late = speeds(setpoints)[-300:, 0]
    np.testing.assert_allclose(late, 0.5, atol=1e-9)


@pytest.mark.parametrize(("by", "passes"), [(0.01, True), (0.3, False), (-0.3, False), (1.0, False)])
def test_servoj_raises_limit_violation_for_a_joint_jump(by: float, passes: bool) -> None:
    generator = standing()
    generator.servoj([*HOME[:5], HOME[5] + by], CYCLE, 0.03, 300.0)
    before = generator.setpoint
    if passes:
        to_rest(generator)
        return
    for _ in range(2):
        with pytest.raises(LimitViolation, match=r"wrist 3: the servoj target is -?\d"):
            generator.advance(CYCLE)
        assert generator.setpoint == before


def test_servoj_raises_limit_violation_for_high_acceleration() -> None:
    """The step is within the distance that the largest speed allows, but starts at rest and without any smoothing."""
    generator = standing()
    generator.servoj([HOME[0] + 0.01, *HOME[1:]], CYCLE, 0.0, 0.0)
    with pytest.raises(LimitViolation, match=r"base: an acceleration of .* which no arm can follow"):
        cycles(generator, 10)


def test_longer_lookahead_allows_larger_steps() -> None:
    generator = standing()
    generator.servoj([*HOME[:5], HOME[5] + 0.15], CYCLE, 0.2, 300.0)
    to_rest(generator)


def ramp(generator: MotionGenerator, fastest: float) -> None:
    way, speed = 0.0, 0.0
    for _ in range(1000):
        speed = min(speed + 20.0 * CYCLE, fastest)
        way += speed * CYCLE
        generator.servoj([HOME[0] + way, *HOME[1:]], CYCLE, 0.03, 300.0)
        generator.advance(CYCLE)


def test_servoj_raises_limit_violation_for_excessive_speed() -> None:
    """A ramp 20 % above the largest joint speed must fail; a ramp 2 % above it passes as rounding."""
    for factor, passes in ((1.02, True), (1.2, False)):
        generator = standing()
        with nullcontext() if passes else pytest.raises(LimitViolation, match="base: "):
            ramp(generator, factor * UR5E.max_speed[0])


def test_servoj_raises_limit_violation_for_position_out_of_range() -> None:
    start = [6.28, *HOME[1:]]
    generator = standing(start)
    generator.servoj([6.2835, *HOME[1:]], CYCLE, 0.03, 300.0)
    with pytest.raises(LimitViolation, match=r"base.*out of range"):
        generator.advance(CYCLE)


def test_servoj_takes_over_a_moving_arm() -> None:
    generator = standing()
    before = generator.setpoint
    generator.speedj([0.0] * 5 + [0.5], 5.0, None)
    setpoints = cycles(generator, 200)
    for _ in range(300):
        generator.servoj(generator.setpoint.q, CYCLE, 0.1, 300.0)
        setpoints += cycles(generator, 1)
    setpoints += to_rest(generator)
    check_continuous(before, setpoints, UR5E.max_acceleration)


@pytest.mark.property
@given(
    st.lists(st.floats(-0.004, 0.004), min_size=1, max_size=60),
    st.sampled_from(ARGUMENTS[:4]),
    st.sampled_from([0.002, 0.008]),
)
def test_servoj_stays_near_its_set_points(steps: list[float], arguments: tuple[float, float], cycle: float) -> None:
    """However the set-points wander, the arm must stay among them and end at the last one."""
    generator = standing()
    goal = 0.0
    goals = [0.0]
    setpoints: list[Setpoint] = []
    for step in steps:
        goal += step
        goals.append(goal)
        generator.servoj([h + goal for h in HOME], cycle, *arguments)
        setpoints.append(generator.advance(cycle))
    setpoints += to_rest(generator, cycle)
    way = positions(setpoints) - HOME
    # The speed of the arm carries it slightly further when the set-points reverse.
    assert way.max() <= max(goals) + 0.004
    assert way.min() >= min(goals) - 0.004
    assert generator.setpoint == ([h + goal for h in HOME], REST, REST)

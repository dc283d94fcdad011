"""movej: joints that start and arrive together."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from linkcore.errors import BadValue
from tests.urlink.simulator.generator.stepping import (
    CYCLE,
    REST,
    UR5E,
    check_continuous,
    finish,
    positions,
    speeds,
    standing,
    to_rest,
    trapezoid,
)
from urlink.arm.models import MODELS, Model
from urlink.simulator.robot.generator import OutOfReach
from urlink.simulator.robot.setpoint_sources import HOME

arms = st.sampled_from(list(MODELS.values()))
postures = st.lists(st.floats(-3.0, 3.0), min_size=6, max_size=6)


def moved(*by: float) -> list[float]:
    return [h + d for h, d in zip(HOME, by, strict=True)]


def test_joints_arrive_together() -> None:
    generator = standing()
    target = moved(0.5, -0.2, 0.3, 0.0, 0.1, 1.0)
    setpoints = finish(generator, generator.movej(target))
    assert generator.setpoint == (target, REST, REST)
    assert generator.is_standing
    assert len(setpoints) == math.ceil(trapezoid(1.0, 1.05, 1.4) / CYCLE)
    parts = (positions(setpoints) - HOME) / np.subtract(target, HOME).clip(1e-300)
    np.testing.assert_allclose(parts[:, 0], parts[:, 5], atol=1e-9)
    assert (speeds(setpoints)[:, 3] == 0.0).all()


@pytest.mark.parametrize(("duration", "takes"), [(3.0, 3.0), (0.001, trapezoid(1.0, math.pi, 40.0)), (0.4, 0.4)])
def test_time_overrides_speed_but_not_limits_of_the_model(duration: float, takes: float) -> None:
    generator = standing()
    setpoints = finish(generator, generator.movej(moved(0, 0, 0, 0, 0, 1.0), a=0.1, v=0.1, t=duration))
    assert len(setpoints) == pytest.approx(takes / CYCLE, abs=1.001)
    assert np.abs(speeds(setpoints)).max() <= math.pi * (1 + 1e-9)


def test_movej_to_the_current_posture_ends_immediately() -> None:
    generator = standing()
    assert len(finish(generator, generator.movej(list(HOME)))) == 1
    assert len(finish(generator, generator.movej(list(HOME), t=1.0))) == 1
    assert generator.setpoint == (list(HOME), REST, REST)


def test_target_out_of_range_is_rejected_immediately() -> None:
    generator = standing()
    before = generator.setpoint
    with pytest.raises(OutOfReach, match=r"base.*7.0000 rad is out of range"):
        generator.movej([7.0, *HOME[1:]])
    assert generator.advance(CYCLE) == before
    finish(generator, generator.movej(moved(0.1, 0, 0, 0, 0, 0)))


def test_endless_wrist_has_no_range() -> None:
    generator = standing(arm=MODELS["UR3e"])
    target = moved(0, 0, 0, 0, 0, 20.0)
    finish(generator, generator.movej(target, v=6.0, a=20.0))
    assert generator.setpoint.q == target


@pytest.mark.parametrize(
    "arguments",
    [{"a": 0.0}, {"v": -1.0}, {"t": -1.0}, {"r": math.nan}, {"q": [0.0] * 5}, {"q": [math.inf] * 6}, {"v": math.inf}],
)
def test_movej_rejects_invalid_arguments(arguments: dict[str, float]) -> None:
    generator = standing()
    with pytest.raises(BadValue):
        generator.movej(**{"q": list(HOME), **arguments})  # type: ignore[arg-type]
    assert generator.is_standing


@pytest.mark.property
@given(arms, postures, postures, st.floats(0.5, 10.0), st.floats(0.5, 60.0), st.sampled_from([0.002, 0.008]))
def test_movej_exceeds_no_limit(
    arm: Model, start: list[float], target: list[float], v: float, a: float, cycle: float
) -> None:
    generator = standing(start, arm)
    before = generator.setpoint
    setpoints = finish(generator, generator.movej(target, a=a, v=v), cycle)
    assert generator.setpoint == (target, REST, REST)
    qd = np.abs(speeds(setpoints))
    assert (qd <= np.minimum(v, arm.max_speed) * (1 + 1e-9)).all()
    check_continuous(before, setpoints, np.minimum(a, arm.max_acceleration), cycle)
    way = np.abs(np.subtract(target, start))
    if way.max() > 0.0:
        share = np.maximum(way / way.max(), 1e-300)
        takes = trapezoid(
            float(way.max()), min(v, (arm.max_speed / share).min()), min(a, (arm.max_acceleration / share).min())
        )
        assert len(setpoints) == pytest.approx(takes / cycle, abs=1.001)


@pytest.mark.property
@given(postures, st.lists(st.floats(-3.0, 3.0), min_size=6, max_size=6), st.integers(1, 800))
def test_another_movej_takes_over_at_the_current_speed(target: list[float], other: list[float], after: int) -> None:
    generator = standing()
    generator.movej(target, v=3.0, a=20.0)
    before = generator.setpoint
    setpoints = [generator.advance(CYCLE) for _ in range(after)]
    generator.movej(other, v=3.0, a=20.0)
    setpoints += to_rest(generator)
    check_continuous(before, setpoints, 2.0 * UR5E.max_acceleration)
    assert (np.abs(speeds(setpoints)) <= UR5E.max_speed * (1 + 1e-9)).all()
    assert generator.setpoint == (other, REST, REST)

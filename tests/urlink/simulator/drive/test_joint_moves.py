"""movej: joints that start and arrive together."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from linkcore.errors import BadValue
from tests.urlink.simulator.drive.stepping import (
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
from urlink.models import MODELS, Model
from urlink.simulator.drive import LimitViolation
from urlink.simulator.motion import HOME

arms = st.sampled_from(list(MODELS.values()))
postures = st.lists(st.floats(-3.0, 3.0), min_size=6, max_size=6)


def moved(*by: float) -> list[float]:
    return [h + d for h, d in zip(HOME, by, strict=True)]


def test_joints_arrive_together() -> None:
    drive = standing()
    target = moved(0.5, -0.2, 0.3, 0.0, 0.1, 1.0)
    setpoints = finish(drive, drive.movej(target))
    assert drive.setpoint == (target, REST, REST)
    assert drive.is_standing
    assert len(setpoints) == math.ceil(trapezoid(1.0, 1.05, 1.4) / CYCLE)
    parts = (positions(setpoints) - HOME) / np.subtract(target, HOME).clip(1e-300)
    np.testing.assert_allclose(parts[:, 0], parts[:, 5], atol=1e-9)
    assert (speeds(setpoints)[:, 3] == 0.0).all()


@pytest.mark.parametrize(("duration", "takes"), [(3.0, 3.0), (0.001, trapezoid(1.0, math.pi, 40.0)), (0.4, 0.4)])
def test_a_time_overrides_speed_and_acceleration_but_not_the_model(duration: float, takes: float) -> None:
    drive = standing()
    setpoints = finish(drive, drive.movej(moved(0, 0, 0, 0, 0, 1.0), a=0.1, v=0.1, t=duration))
    assert len(setpoints) == pytest.approx(takes / CYCLE, abs=1.001)
    assert np.abs(speeds(setpoints)).max() <= math.pi * (1 + 1e-9)


def test_no_way_to_go_is_over_at_once() -> None:
    drive = standing()
    assert len(finish(drive, drive.movej(list(HOME)))) == 1
    assert len(finish(drive, drive.movej(list(HOME), t=1.0))) == 1
    assert drive.setpoint == (list(HOME), REST, REST)


def test_a_target_out_of_range_is_refused_in_the_next_cycle() -> None:
    drive = standing()
    before = drive.setpoint
    drive.movej([7.0, *HOME[1:]])
    with pytest.raises(LimitViolation, match=r"base.*7.0000 rad is out of range"):
        drive.advance(CYCLE)
    assert drive.setpoint == before
    finish(drive, drive.movej(moved(0.1, 0, 0, 0, 0, 0)))


def test_the_endless_wrist_has_no_range() -> None:
    drive = standing(arm=MODELS["UR3e"])
    target = moved(0, 0, 0, 0, 0, 20.0)
    finish(drive, drive.movej(target, v=6.0, a=20.0))
    assert drive.setpoint.q == target


@pytest.mark.parametrize(
    "arguments",
    [{"a": 0.0}, {"v": -1.0}, {"t": -1.0}, {"r": math.nan}, {"q": [0.0] * 5}, {"q": [math.inf] * 6}, {"v": math.inf}],
)
def test_arguments_without_meaning(arguments: dict[str, float]) -> None:
    drive = standing()
    with pytest.raises(BadValue):
        drive.movej(**{"q": list(HOME), **arguments})  # type: ignore[arg-type]
    assert drive.is_standing


@pytest.mark.property
@given(arms, postures, postures, st.floats(0.5, 10.0), st.floats(0.5, 60.0), st.sampled_from([0.002, 0.008]))
def test_no_limit_is_exceeded(
    arm: Model, start: list[float], target: list[float], v: float, a: float, cycle: float
) -> None:
    drive = standing(start, arm)
    before = drive.setpoint
    setpoints = finish(drive, drive.movej(target, a=a, v=v), cycle)
    assert drive.setpoint == (target, REST, REST)
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
def test_another_movej_takes_over_at_the_present_speed(target: list[float], other: list[float], after: int) -> None:
    drive = standing()
    drive.movej(target, v=3.0, a=20.0)
    before = drive.setpoint
    setpoints = [drive.advance(CYCLE) for _ in range(after)]
    drive.movej(other, v=3.0, a=20.0)
    setpoints += to_rest(drive)
    check_continuous(before, setpoints, 2.0 * UR5E.max_acceleration)
    assert (np.abs(speeds(setpoints)) <= UR5E.max_speed * (1 + 1e-9)).all()
    assert drive.setpoint == (other, REST, REST)

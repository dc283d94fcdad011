"""Speed profiles compared with their definition."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.urlink.simulator.generator.stepping import trapezoid
from urlink.simulator.robot.generator.path_motion import Trapezoid, timed

lengths = st.floats(1e-3, 10.0)
rates = st.floats(0.05, 50.0)


def test_profile_of_zero_length_takes_no_time() -> None:
    assert Trapezoid(0.0, 1.0, 1.0).duration == 0.0
    assert Trapezoid(0.0, 1.0, 1.0).at(0.0) == (0.0, 0.0, 0.0)


@pytest.mark.property
@given(lengths, rates, rates, rates, st.floats(0.0, 1.0))
def test_profile_speed_is_the_derivative_of_its_position(
    length: float, speed: float, fall: float, rise: float, part: float
) -> None:
    profile = Trapezoid(length, speed, fall, rise)
    time, step = part * profile.duration, 1e-6 * profile.duration
    way, now, acceleration = profile.at(time)
    later, then, _ = profile.at(time + step)
    assert -1e-12 <= way <= length * (1 + 1e-9)
    assert 0.0 <= now <= profile.peak * (1 + 1e-9) <= speed * (1 + 2e-9)
    assert -fall <= acceleration <= rise
    assert later - way == pytest.approx(0.5 * step * (now + then), rel=1e-3, abs=1e-9 * length)
    assert abs(then - now) <= max(rise, fall) * step * (1 + 1e-6) + 1e-9 * speed
    assert profile.at(profile.duration) == (length, 0.0, 0.0)


@pytest.mark.property
@given(lengths, rates, rates)
def test_duration_equals_that_of_a_trapezoid(length: float, speed: float, acceleration: float) -> None:
    assert Trapezoid(length, speed, acceleration).duration == pytest.approx(trapezoid(length, speed, acceleration))


@pytest.mark.property
@given(lengths, st.floats(0.01, 100.0), rates, rates)
def test_requested_time_is_kept_if_the_limits_allow(length: float, wanted: float, v: float, a: float) -> None:
    speed, acceleration = timed(length, wanted, v, a)
    assert speed <= v * (1 + 1e-9)
    assert acceleration <= a * (1 + 1e-9)
    takes = Trapezoid(length, speed, acceleration).duration
    assert takes == pytest.approx(max(wanted, trapezoid(length, v, a)), rel=1e-6)

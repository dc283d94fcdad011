"""Conversion of poses to counters: the formulas of the original bridge."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from linkcore.errors import BadValue
from rhdlink.host.plugins.velocity import Odometer
from rhdlink.variables.value_types import wrapped


def test_first_pose_sets_the_zero_of_the_distance() -> None:
    odometer = Odometer()
    odometer.update(3.0, 4.0, 0.5)
    assert (odometer.transpos, odometer.rotpos) == (0, 20000)


def test_displacement_is_projected_on_the_heading() -> None:
    odometer = Odometer()
    odometer.update(0.0, 0.0, 0.0)
    odometer.update(3.0, 4.0, math.pi / 6)
    assert odometer.transpos == round((3.0 * math.cos(math.pi / 6) + 4.0 * math.sin(math.pi / 6)) * 1e5)
    # Driving backwards counts down, and driving sideways counts nothing.
    odometer.update(3.0, 3.0, math.pi / 2)
    assert odometer.transpos == round((3.0 * math.cos(math.pi / 6) + 4.0 * math.sin(math.pi / 6) - 1.0) * 1e5)
    before = odometer.transpos
    odometer.update(9.0, 3.0, math.pi / 2)
    assert odometer.transpos == before


def test_fractions_of_a_count_are_kept() -> None:
    odometer = Odometer(linear_scale=10.0)
    for step in range(101):
        odometer.update(0.04 * step, 0.0, 0.0)
    assert odometer.transpos == 40


def test_wrapped_heading_is_continued_across_the_border() -> None:
    odometer = Odometer()
    for degrees in range(0, 721, 30):
        odometer.update(0.0, 0.0, math.remainder(math.radians(degrees), 2 * math.pi))
    assert odometer.rotpos == round(4 * math.pi * 40000)


def test_scales_convert_distance_and_angle_to_counts() -> None:
    odometer = Odometer(linear_scale=-2.0, angular_scale=10.0)
    odometer.update(0.0, 0.0, 1.0)
    odometer.update(math.cos(1.0) * 50, math.sin(1.0) * 50, 1.0)
    assert (odometer.transpos, odometer.rotpos) == (-100, 10)


@pytest.mark.parametrize(
    ("count", "value"),
    [(0.4, 0), (-0.6, -1), (2**31 - 1, 2**31 - 1), (2**31, -(2**31)), (-(2**31) - 1, 2**31 - 1), (2**32 + 5, 5)],
)
def test_counters_wrap_at_32_bits(count: float, value: int) -> None:
    assert wrapped(count) == value


@pytest.mark.parametrize("pose", [(math.nan, 0, 0), (0, math.inf, 0), (0, 0, math.nan), (1e308, 0, 0)])
def test_invalid_pose_is_rejected_and_changes_nothing(pose: tuple[float, float, float]) -> None:
    odometer = Odometer()
    odometer.update(0.0, 0.0, 0.0)
    with pytest.raises(BadValue):
        odometer.update(*pose)
    odometer.update(1.0, 0.0, 0.0)
    assert odometer.transpos == 100000


@pytest.mark.parametrize("scale", [0.0, math.nan, math.inf])
def test_odometer_rejects_invalid_scales(scale: float) -> None:
    with pytest.raises(BadValue):
        Odometer(linear_scale=scale)
    with pytest.raises(BadValue):
        Odometer(angular_scale=scale)


@pytest.mark.property
@given(st.lists(st.tuples(st.floats(), st.floats(), st.floats()), max_size=20))
def test_any_pose_gives_a_32_bit_counter_or_bad_value(poses: list[tuple[float, float, float]]) -> None:
    odometer = Odometer()
    for pose in poses:
        try:
            odometer.update(*pose)
        except BadValue:
            continue
        assert -(2**31) <= odometer.transpos < 2**31
        assert -(2**31) <= odometer.rotpos < 2**31

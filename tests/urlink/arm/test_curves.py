"""Lines and arcs of the tool, compared with their definitions."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from linkcore.errors import BadValue
from tests.urlink.arm.arms import Array, poses
from urlink.arm.curves import Arc, Curve, Line
from urlink.arm.poses import compose, invert, to_matrix

parts = st.floats(0.0, 1.0)


def apart(first: list[float], second: list[float]) -> float:
    return float(np.abs(to_matrix(first) - to_matrix(second)).max())


def arc_of(start: Array, via: Array, end: Array) -> Arc:
    """Return the arc through three poses that are clearly not on a line."""
    first, between, last = start[:3], via[:3], end[:3]
    area = np.linalg.norm(np.cross(between - first, last - first))
    assume(area > 1e-2)
    assume(min(np.linalg.norm(between - first), np.linalg.norm(last - first), np.linalg.norm(last - between)) > 0.05)
    return Arc(start.tolist(), via.tolist(), end.tolist())


def is_even(curve: Curve, part: float) -> None:
    """Check that the speed and the turning speed are the same everywhere."""
    step = 1e-4
    here, there = curve.pose(part), curve.pose(part + step)
    assert math.dist(here[:3], there[:3]) == pytest.approx(curve.length * step, rel=1e-4, abs=1e-9)
    turned = float(np.linalg.norm(compose(invert(here), there)[3:]))
    assert turned == pytest.approx(curve.turn * step, rel=1e-4, abs=1e-9)


@pytest.mark.property
@given(poses(), poses(), parts)
def test_line_is_straight_with_constant_speed(start: Array, end: Array, part: float) -> None:
    line = Line(start.tolist(), end.tolist())
    assert apart(line.pose(0.0), start.tolist()) < 1e-9
    assert apart(line.pose(1.0), end.tolist()) < 1e-9
    is_even(line, part)
    np.testing.assert_allclose(line.pose(part)[:3], start[:3] + part * (end[:3] - start[:3]), atol=1e-12)
    if line.length > 1e-3:
        assert line.part(line.pose(part)) == pytest.approx(part, abs=1e-9)


@pytest.mark.property
@given(poses(), poses(), poses(), parts)
def test_arc_has_constant_speed_and_passes_through_middle_point(
    start: Array, via: Array, end: Array, part: float
) -> None:
    arc = arc_of(start, via, end)
    assert apart(arc.pose(0.0), start.tolist()) < 1e-9
    assert apart(arc.pose(1.0), end.tolist()) < 1e-9
    between = arc.part(via.tolist())
    assert 0.0 < between < 1.0
    np.testing.assert_allclose(arc.pose(between)[:3], via[:3], atol=1e-9)
    is_even(arc, part)
    if 1e-6 < part < 1.0 - 1e-6:
        assert arc.part(arc.pose(part)) == pytest.approx(part, abs=1e-9)


def test_position_beyond_a_curve_end_maps_to_that_end() -> None:
    line = Line([0.0] * 6, [1.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    assert [line.part([x, 5.0, 0.0]) for x in (-1.0, 0.25, 2.0)] == [0.0, 0.25, 1.0]
    quarter = Arc([1.0, 0, 0, 0, 0, 0], [math.sqrt(0.5), math.sqrt(0.5), 0, 0, 0, 0], [0, 1.0, 0, 0, 0, 0])
    assert quarter.length == pytest.approx(math.pi / 2.0)
    assert [quarter.part(p) for p in ([-0.1, 1.0, 0.0], [1.0, -0.1, 0.0])] == [1.0, 0.0]
    assert Line([1.0] * 6, [1.0] * 6).part([0.0] * 3) == 0.0


def test_tool_orientation_turns_with_the_arc_if_fixed() -> None:
    quarter = Arc(
        [1.0, 0, 0, 0, 0, 0.5], [math.sqrt(0.5), math.sqrt(0.5), 0, 0, 0, 0], [0, 1.0, 0, 0, 0, 0], is_fixed=True
    )
    assert apart(quarter.end, [0.0, 1.0, 0.0, 0.0, 0.0, 0.5 + math.pi / 2.0]) < 1e-12


@pytest.mark.parametrize("via", [[0.5, 0.0, 0.0], [0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [2.0, 0.0, 0.0]])
def test_arc_rejects_points_on_a_line(via: list[float]) -> None:
    with pytest.raises(BadValue, match="are on a straight line"):
        Arc([0.0] * 6, [*via, 0.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0, 0.0, 0.0])

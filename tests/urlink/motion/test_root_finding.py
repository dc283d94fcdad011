"""Root of an increasing function: its position, and the number of function calls."""

from __future__ import annotations

import math
from collections.abc import Callable

import pytest

from urlink.motion.servo.jerk_limited import root

PRECISION = 1e-12

#: function, lower and upper end, root, maximum number of calls (two for the ends, then two in each step)
GROWING: list[tuple[Callable[[float], float], float, float, float, int]] = [
    (lambda x: 3.0 * x - 1.0, 0.0, 1.0, 1.0 / 3.0, 4),
    (lambda x: x**3 - 1e-3, 0.0, 1.0, 0.1, 16),
    (lambda x: x**3 + x - 10.0, -5.0, 20.0, 2.0, 16),
    (lambda x: x * abs(x) + 0.25, -1.0, 1.0, -0.5, 14),
    (lambda x: math.exp(x) - 2.0, 0.0, 10.0, math.log(2.0), 10),
    # The function jumps past zero, so the bracket shrinks to nothing.
    (lambda x: math.copysign(1.0, x - 0.3), 0.0, 1.0, 0.3, 122),
    (lambda x: min(x, 0.01 * x + 0.99) - 1.5, 0.0, 100.0, 51.0, 6),
]


@pytest.mark.parametrize(("function", "low", "high", "place", "most"), GROWING)
def test_root_is_found_in_few_steps(
    function: Callable[[float], float], low: float, high: float, place: float, most: int
) -> None:
    asked: list[float] = []

    def counted(x: float) -> float:
        asked.append(x)
        return function(x)

    found = root(counted, low, high, PRECISION)
    assert found == pytest.approx(place, abs=1e-9)
    assert abs(function(found)) <= PRECISION or function(found) == -1.0
    assert all(low <= x <= high for x in asked)
    assert len(asked) <= most


@pytest.mark.parametrize(
    ("below", "above", "place"),
    [(0.0, 1.0, 0.0), (0.5, 1.0, 0.0), (-0.25, 1.0, 0.0), (-1.0, 0.0, 1.0), (-1.0, 0.25, 1.0), (-0.25, 0.25, 0.0)],
)
def test_end_within_precision_is_returned(below: float, above: float, place: float) -> None:
    """This holds even if rounding has put the root slightly outside the bracket."""
    values = {0.0: below, 1.0: above}
    assert root(values.__getitem__, 0.0, 1.0, 0.25) == place

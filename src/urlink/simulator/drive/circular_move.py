"""An arc of the tool: movec."""

from __future__ import annotations

import math
from collections.abc import Sequence

from urlink.models import Model

from .. import kinematics
from .limits import Unreachable
from .tool_path import RADIAN, ToolPath, rotated, turn_between

__all__ = ["CircularPath"]

# Of the distances between the three points: closer to a straight line than that they have no circle.
_FLAT = 1e-6


class CircularPath(ToolPath):
    """The TCP goes along the circle through its start and two more points.

    The tool turns about one axis to the orientation at the end, evenly; or, held fast to the path, along with the arc:
    then the orientation at the end is not the one asked for. The orientation of the point between does not count.
    """

    def __init__(
        self, model: Model, tcp: Sequence[float], start: list[float], via: list[float], end: list[float], fixed: bool
    ) -> None:
        """From joint positions by way of a pose to a pose; `fixed` keeps the tool as it is towards the path.

        Raises:
            Unreachable: the three points are on no circle, or the arm does not reach the end.
        """
        self._start: list[float] = kinematics.pose(model, start, tcp).tolist()
        first, between, last = self._start[:3], via[:3], end[:3]
        self._centre, normal = _circle(first, between, last)
        self._arm = _minus(first, self._centre)
        radius = math.hypot(*self._arm)
        self._across = _cross(normal, self._arm)
        # About this normal the three points follow each other within one turn.
        chord = _minus(last, self._centre)
        self._arc = math.atan2(_dot(chord, self._across), _dot(chord, self._arm)) % math.tau
        self._fixed = [self._arc * part for part in normal] if fixed else None
        self._turn = turn_between(self._start, end)
        if fixed:
            end = [*last, *self._carried(1.0)]
        length = max(radius * self._arc, 0.0 if fixed else RADIAN * math.hypot(*self._turn))
        super().__init__(model, tcp, length, end, start)

    def pose(self, part: float) -> list[float]:
        """Where the TCP is, after a part in [0, 1] of the way."""
        cosine, sine = math.cos(part * self._arc), math.sin(part * self._arc)
        position = [c + cosine * x + sine * y for c, x, y in zip(self._centre, self._arm, self._across, strict=True)]
        turned = rotated(self._start, self._turn, part) if self._fixed is None else self._carried(part)
        return position + turned

    def _carried(self, part: float) -> list[float]:
        """The rotation vector of the start, turned about the axis of the circle."""
        assert self._fixed is not None
        x, y, z = self._fixed
        turned: list[float] = kinematics.pose_trans(
            (0.0, 0.0, 0.0, part * x, part * y, part * z), (0.0, 0.0, 0.0, *self._start[3:])
        ).tolist()
        return turned[3:]


def _circle(first: list[float], between: list[float], last: list[float]) -> tuple[list[float], list[float]]:
    """The centre of the circle through three points, and its axis, about which they follow each other."""
    u, w = _minus(between, first), _minus(last, first)
    normal = _cross(u, w)
    uu, ww, squared = _dot(u, u), _dot(w, w), _dot(normal, normal)
    if squared <= _FLAT**2 * uu * ww:
        raise Unreachable("the start, the point between and the end of an arc are on no circle")
    p, q = _cross(w, normal), _cross(normal, u)
    centre = [f + (uu * a + ww * b) / (2.0 * squared) for f, a, b in zip(first, p, q, strict=True)]
    size = math.sqrt(squared)
    return centre, [part / size for part in normal]


def _minus(a: Sequence[float], b: Sequence[float]) -> list[float]:
    return [x - y for x, y in zip(a, b, strict=True)]


def _dot(a: Sequence[float], b: Sequence[float]) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _cross(a: Sequence[float], b: Sequence[float]) -> list[float]:
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]

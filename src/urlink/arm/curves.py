"""Paths of a tool between two poses: straight lines and arcs of circles.

On both paths, the tool turns uniformly about one axis, from its start orientation to its end orientation. Users have
observed that controllers turn the tool in this way between two poses. For arcs, the vendor documents it for ``movec``
with mode 0, "unconstrained": the controller ignores the orientation of the intermediate point.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from linkcore.errors import BadValue

from .poses import compose, invert

# Three points that are closer to a straight line than this do not define a circle. The value is relative to the
# distances between the points.
_FLAT = 1e-6


class Line:
    """Straight path of the tool from one pose to another.

    Attributes:
        start: Pose at the beginning, in m and rad.
        end: Pose at the end, in m and rad.
        length: Length of the path of the tool centre, in m.
        turn: Angle of the rotation of the tool on the path, in rad.
    """

    def __init__(self, start: Sequence[float], end: Sequence[float]) -> None:
        self.start, self.end = list(start), list(end)
        self._way = _minus(self.end[:3], self.start[:3])
        self._rotation = _turn_between(self.start, self.end)
        self.length = math.hypot(*self._way)
        self.turn = math.hypot(*self._rotation)

    def pose(self, part: float) -> list[float]:
        """Return the pose after a fraction of the path, 0 to 1: position in m, rotation vector in rad."""
        position = [a + part * way for a, way in zip(self.start[:3], self._way, strict=True)]
        return position + _rotated(self.start, self._rotation, part)

    def part(self, position: Sequence[float]) -> float:
        """Return the fraction of the path, 0 to 1, where the tool is closest to a position, shape (3,), in m."""
        if self.length == 0.0:
            return 0.0
        along = _dot(_minus(position[:3], self.start[:3]), self._way) / (self.length * self.length)
        return min(max(along, 0.0), 1.0)


class Arc:
    """Path of the tool along the circle through three points. The class has the methods of `Line`.

    Args:
        start: Pose at the beginning.
        via: Intermediate pose on the path; its orientation is ignored.
        end: Pose at the end.
        is_fixed: Whether the tool is fixed to the path and turns with it. In this case, the start orientation
            determines the end orientation, and the orientation of `end` is ignored.

    Attributes:
        start: See `Line`.
        end: See `Line`.
        length: See `Line`.
        turn: See `Line`. If the tool is fixed to the path, its rotation with the path is not included.

    Raises:
        BadValue: If the three points are on a straight line.
    """

    def __init__(
        self, start: Sequence[float], via: Sequence[float], end: Sequence[float], *, is_fixed: bool = False
    ) -> None:
        self.start, self.end = list(start), list(end)
        first, last = self.start[:3], self.end[:3]
        self._centre, normal = _circle(first, list(via[:3]), last)
        self._arm = _minus(first, self._centre)
        self._across = _cross(normal, self._arm)
        # In one turn about this normal, the points come in the order start, via, end.
        self._angle = self._angle_of(last)
        self.length = math.hypot(*self._arm) * self._angle
        self._carried = [self._angle * each for each in normal] if is_fixed else None
        self._rotation = [0.0] * 3 if is_fixed else _turn_between(self.start, self.end)
        if is_fixed:
            self.end = self.pose(1.0)
        self.turn = math.hypot(*self._rotation)

    def pose(self, part: float) -> list[float]:
        """Return the pose after a fraction of the path, 0 to 1."""
        cosine, sine = math.cos(part * self._angle), math.sin(part * self._angle)
        position = [c + cosine * x + sine * y for c, x, y in zip(self._centre, self._arm, self._across, strict=True)]
        if self._carried is None:
            return position + _rotated(self.start, self._rotation, part)
        turn = [0.0, 0.0, 0.0, *(part * each for each in self._carried)]
        turned: list[float] = compose(turn, [0.0, 0.0, 0.0, *self.start[3:]]).tolist()
        return position + turned[3:]

    def part(self, position: Sequence[float]) -> float:
        """Return the fraction of the path where the tool is closest to a position."""
        angle = self._angle_of(position)
        if angle > self._angle:
            # The position is beyond the end of the arc: use the closer of its two ends.
            return 1.0 if angle < 0.5 * (self._angle + math.tau) else 0.0
        return angle / self._angle

    def _angle_of(self, position: Sequence[float]) -> float:
        """Return the angle about the axis from the start of the arc to a position, 0 to 2 pi."""
        chord = _minus(position[:3], self._centre)
        return math.atan2(_dot(chord, self._across), _dot(chord, self._arm)) % math.tau


#: Path between two poses.
Curve = Line | Arc


def _circle(first: list[float], between: list[float], last: list[float]) -> tuple[list[float], list[float]]:
    """Return the centre and the axis of the circle through three points. A turn about the axis passes them in order."""
    u, w = _minus(between, first), _minus(last, first)
    normal = _cross(u, w)
    uu, ww, squared = _dot(u, u), _dot(w, w), _dot(normal, normal)
    if squared <= _FLAT**2 * uu * ww:
        raise BadValue("the start, intermediate and end points are on a straight line; an arc needs three on a circle")
    p, q = _cross(w, normal), _cross(normal, u)
    centre = [f + (uu * a + ww * b) / (2.0 * squared) for f, a, b in zip(first, p, q, strict=True)]
    size = math.sqrt(squared)
    return centre, [part / size for part in normal]


def _turn_between(first: Sequence[float], second: Sequence[float]) -> list[float]:
    """Return the rotation vector of the shortest turn from the first pose to the second, in the first frame, in rad."""
    turn: list[float] = compose(invert(first), second).tolist()[3:]
    return turn


def _rotated(pose: Sequence[float], turn: Sequence[float], part: float) -> list[float]:
    """Return the rotation vector of a pose after a fraction of the rotation `turn` in the frame of the pose."""
    if not any(turn):
        return list(pose[3:])
    x, y, z = turn
    turned: list[float] = compose((0.0, 0.0, 0.0, *pose[3:]), (0.0, 0.0, 0.0, part * x, part * y, part * z)).tolist()
    return turned[3:]


def _minus(a: Sequence[float], b: Sequence[float]) -> list[float]:
    return [x - y for x, y in zip(a, b, strict=True)]


def _dot(a: Sequence[float], b: Sequence[float]) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _cross(a: Sequence[float], b: Sequence[float]) -> list[float]:
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]

"""Curves along which a tool goes from one pose to another: straight lines, and arcs of circles.

On both the tool turns evenly about one axis, from its orientation at the beginning to that at the end, as it moves on.
That a controller does the same between two poses is what its users see; that it does so on an arc, where the
orientation of the point between does not count, is documented for ``movec`` with the mode 0, "unconstrained".
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from linkcore.errors import BadValue

from .poses import compose, invert

# Of the distances between three points: closer to a straight line than that they are on no circle.
_FLAT = 1e-6


class Line:
    """The tool goes straight from one pose to another.

    Attributes:
        start, end: the poses at both ends, m and rad.
        length: of the path of the tool's centre, m.
        turn: the angle by which the tool turns on the path, rad.
    """

    def __init__(self, start: Sequence[float], end: Sequence[float]) -> None:
        self.start, self.end = list(start), list(end)
        self._way = _minus(self.end[:3], self.start[:3])
        self._rotation = _turn_between(self.start, self.end)
        self.length = math.hypot(*self._way)
        self.turn = math.hypot(*self._rotation)

    def pose(self, part: float) -> list[float]:
        """Where the tool is after a part of the path, 0 to 1: m, and rotation vector in rad."""
        position = [a + part * way for a, way in zip(self.start[:3], self._way, strict=True)]
        return position + _rotated(self.start, self._rotation, part)

    def part(self, position: Sequence[float]) -> float:
        """The part of the path at which the tool is closest to a position (3, m), 0 to 1."""
        if self.length == 0.0:
            return 0.0
        along = _dot(_minus(position[:3], self.start[:3]), self._way) / (self.length * self.length)
        return min(max(along, 0.0), 1.0)


class Arc:
    """The tool goes along the circle through three points; methods as those of `Line`.

    Args:
        start: the pose at the beginning.
        via: a pose on the path, of which only the position counts.
        end: the pose at the end.
        is_fixed: the tool is held fast to the path and turns along with it. Then its orientation at the end follows
            from that at the beginning, and that of `end` does not count.

    Attributes:
        start, end, length: as those of `Line`.
        turn: as that of `Line`; not counted is how far the arc carries the tool along.

    Raises:
        BadValue: the three points are on a straight line.
    """

    def __init__(
        self, start: Sequence[float], via: Sequence[float], end: Sequence[float], *, is_fixed: bool = False
    ) -> None:
        self.start, self.end = list(start), list(end)
        first, last = self.start[:3], self.end[:3]
        self._centre, normal = _circle(first, list(via[:3]), last)
        self._arm = _minus(first, self._centre)
        self._across = _cross(normal, self._arm)
        # About this normal the three points follow each other within one turn.
        self._angle = self._angle_of(last)
        self.length = math.hypot(*self._arm) * self._angle
        self._carried = [self._angle * each for each in normal] if is_fixed else None
        self._rotation = [0.0] * 3 if is_fixed else _turn_between(self.start, self.end)
        if is_fixed:
            self.end = self.pose(1.0)
        self.turn = math.hypot(*self._rotation)

    def pose(self, part: float) -> list[float]:
        """Where the tool is after a part of the path."""
        cosine, sine = math.cos(part * self._angle), math.sin(part * self._angle)
        position = [c + cosine * x + sine * y for c, x, y in zip(self._centre, self._arm, self._across, strict=True)]
        if self._carried is None:
            return position + _rotated(self.start, self._rotation, part)
        turn = [0.0, 0.0, 0.0, *(part * each for each in self._carried)]
        turned: list[float] = compose(turn, [0.0, 0.0, 0.0, *self.start[3:]]).tolist()
        return position + turned[3:]

    def part(self, position: Sequence[float]) -> float:
        """The part of the path at which the tool is closest to a position."""
        angle = self._angle_of(position)
        if angle > self._angle:
            # Beyond the end: the end that is closer.
            return 1.0 if angle < 0.5 * (self._angle + math.tau) else 0.0
        return angle / self._angle

    def _angle_of(self, position: Sequence[float]) -> float:
        """From the beginning to a position, about the axis: 0 to 2 pi."""
        chord = _minus(position[:3], self._centre)
        return math.atan2(_dot(chord, self._across), _dot(chord, self._arm)) % math.tau


#: A path between two poses.
Curve = Line | Arc


def _circle(first: list[float], between: list[float], last: list[float]) -> tuple[list[float], list[float]]:
    """The centre of the circle through three points, and its axis, about which they follow each other."""
    u, w = _minus(between, first), _minus(last, first)
    normal = _cross(u, w)
    uu, ww, squared = _dot(u, u), _dot(w, w), _dot(normal, normal)
    if squared <= _FLAT**2 * uu * ww:
        raise BadValue("the start, the point between and the end of an arc are on no circle")
    p, q = _cross(w, normal), _cross(normal, u)
    centre = [f + (uu * a + ww * b) / (2.0 * squared) for f, a, b in zip(first, p, q, strict=True)]
    size = math.sqrt(squared)
    return centre, [part / size for part in normal]


def _turn_between(first: Sequence[float], second: Sequence[float]) -> list[float]:
    """The rotation vector, in the frame of the first pose, of the shortest turn to the second, rad."""
    turn: list[float] = compose(invert(first), second).tolist()[3:]
    return turn


def _rotated(pose: Sequence[float], turn: Sequence[float], part: float) -> list[float]:
    """The rotation vector of a pose after part of a turn in its own frame."""
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

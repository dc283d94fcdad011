"""Paths of the tool: straight lines (movel, movep, servoc) and circles (movec), by the analytic inverse kinematics."""

from __future__ import annotations

import math
from collections.abc import Sequence

from urlink import kinematics
from urlink.kinematics import Arm
from urlink.poses import compose, invert

from ..sources import Setpoint
from .joint_limits import LimitViolation, Unreachable

__all__ = ["CircularPath", "LinearPath", "joints_at", "setpoint_at"]

#: m of a path that a turn of one radian is worth at least, so that a tool which turns in place takes its time. A guess.
RADIAN = 0.25

_REST = [0.0] * 6


def joints_at(arm: Arm, pose: Sequence[float], tcp: Sequence[float], near: Sequence[float]) -> list[float]:
    """The joint positions closest to `near` that put the TCP at a pose.

    Raises:
        Unreachable: there are none.
    """
    try:
        found: list[float] = arm.inverse(pose, near, tcp, is_limited=False).tolist()
    except kinematics.Unreachable:
        raise Unreachable(f"the arm does not reach the pose {[round(number, 4) for number in pose]}") from None
    return found


def setpoint_at(arm: Arm, pose: Sequence[float], tcp: Sequence[float], last: Setpoint, seconds: float) -> Setpoint:
    """The joints at a pose of the TCP, one cycle after `last`; speeds and accelerations are differences.

    Raises:
        Unreachable: the arm does not reach the pose.
    """
    q = joints_at(arm, pose, tcp, last.q)
    qd = [(new - old) / seconds for new, old in zip(q, last.q, strict=True)]
    return Setpoint(q, qd, [(new - old) / seconds for new, old in zip(qd, last.qd, strict=True)])


def turn_between(first: Sequence[float], second: Sequence[float]) -> list[float]:
    """The rotation vector, in the frame of the first pose, of the shortest turn to the second, rad."""
    turn: list[float] = compose(invert(first), second).tolist()[3:]
    return turn


def rotated(pose: Sequence[float], turn: Sequence[float], part: float) -> list[float]:
    """The rotation vector of a pose after part of a turn in its own frame."""
    if not any(turn):
        return list(pose[3:])
    x, y, z = turn
    turned: list[float] = compose((0.0, 0.0, 0.0, *pose[3:]), (0.0, 0.0, 0.0, part * x, part * y, part * z)).tolist()
    return turned[3:]


class ToolPath:
    """A path of the tool: what lines and circles share. Its length is in m.

    Attributes:
        length: m.
        speed, acceleration: those of the joints have no such limits: a joint that gets too fast is a violation.
        end_pose: of the TCP at the end, m and rad.
    """

    speed = math.inf
    acceleration = math.inf

    def __init__(self, arm: Arm, tcp: Sequence[float], length: float, end: list[float], near: list[float]) -> None:
        self._kinematics, self._tcp = arm, tcp
        self.length = length
        self.end_pose = end
        self._end_joints: list[float] | None = None
        joints_at(arm, end, tcp, near)

    def pose(self, part: float) -> list[float]:
        """Where the TCP is, after a part in [0, 1] of the way."""
        raise NotImplementedError

    def setpoint(self, way: float, speed: float, acceleration: float, last: Setpoint, seconds: float) -> Setpoint:
        """The joints where so much of the way is behind the tool; `last` is the set-point of the cycle before.

        Raises:
            LimitViolation: the arm does not reach so far.
        """
        if not speed and not acceleration:
            return Setpoint(last.q, _REST, _REST)
        try:
            return setpoint_at(self._kinematics, self.pose(way / self.length), self._tcp, last, seconds)
        except Unreachable as error:
            raise LimitViolation(str(error)) from None

    def end(self, near: Sequence[float]) -> list[float]:
        """The joints at the end, by the branch of the inverse kinematics that they come from.

        Raises:
            LimitViolation: from there the arm does not reach it.
        """
        if self._end_joints is None:
            try:
                self._end_joints = joints_at(self._kinematics, self.end_pose, self._tcp, near)
            except Unreachable as error:
                raise LimitViolation(str(error)) from None
        return self._end_joints

    def left(self, q: Sequence[float]) -> float:
        """How far the TCP is from its place at the end when the joints are at `q`, m."""
        return math.dist(self._kinematics.forward(q, self._tcp)[:3].tolist(), self.end_pose[:3])


class LinearPath(ToolPath):
    """The TCP goes straight to a pose while the tool turns about one axis, both in proportion."""

    def __init__(self, arm: Arm, tcp: Sequence[float], start: list[float], end: list[float]) -> None:
        """From joint positions to a pose.

        Raises:
            Unreachable: the arm does not reach the pose.
        """
        self._start: list[float] = arm.forward(start, tcp).tolist()
        self._way = [b - a for a, b in zip(self._start[:3], end[:3], strict=True)]
        self._turn = turn_between(self._start, end)
        length = max(math.hypot(*self._way), RADIAN * math.hypot(*self._turn))
        super().__init__(arm, tcp, length, end, start)

    def pose(self, part: float) -> list[float]:
        """Where the TCP is, after a part in [0, 1] of the way."""
        position = [a + part * way for a, way in zip(self._start[:3], self._way, strict=True)]
        return position + rotated(self._start, self._turn, part)


# Of the distances between the three points: closer to a straight line than that they have no circle.
_FLAT = 1e-6


class CircularPath(ToolPath):
    """The TCP goes along the circle through its start and two more points.

    The tool turns about one axis to the orientation at the end, evenly; or, held fast to the path, along with the arc:
    then the orientation at the end is not the one asked for. The orientation of the point between does not count.
    """

    def __init__(
        self, arm: Arm, tcp: Sequence[float], start: list[float], via: list[float], end: list[float], fixed: bool
    ) -> None:
        """From joint positions by way of a pose to a pose; `fixed` keeps the tool as it is towards the path.

        Raises:
            Unreachable: the three points are on no circle, or the arm does not reach the end.
        """
        self._start: list[float] = arm.forward(start, tcp).tolist()
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
        super().__init__(arm, tcp, length, end, start)

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
        turned: list[float] = compose(
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

"""`drivetopoint`: drive to a pose along an arc, a straight line and an arc.

Each piece is driven forward or backward.

Both arcs have the same radius. The first circle touches the start pose on its left or right, and the last circle
touches the goal in the same way. A common tangent joins the circles, and each arc can follow its circle in either
direction. The shortest of all these paths is chosen. A later path replaces the best one only if it is at least 1 mm
shorter. So the order of the enumeration affects the result, and it is the order of MRC (drivetopoint_generate.c and
drivetopoint_evaluate.c by J. M. Bruun and O. Corradi).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

from ..arithmetic import cosine, sine
from ..planar_pose import PlanarPose
from .basic import FollowDirection, Forward
from .control import ControlledMotion, MotionControl
from .turning import ArcTurn

#: Lengths in m, or angles in rad, below which a value counts as zero while paths are made, and while they are compared.
_EXACT, _NEGLIGIBLE = 1e-6, 1e-3


@dataclass(frozen=True)
class ArcPath:
    """Path to a pose: an arc, a straight piece and an arc.

    Attributes:
        first, last: Angles of the arcs in rad; positive if the centre is on the left.
        first_direction, last_direction: 1 for forward, -1 for backward.
        straight: Length of the straight piece, in m.
        straight_direction: 1 for forward, -1 for backward, or 0 without a straight piece.
    """

    first: float
    first_direction: int
    straight: float
    straight_direction: int
    last: float
    last_direction: int

    def length(self, radius: float) -> float:
        """Return the length of the path in m, with arcs of `radius`."""
        return radius * (abs(self.first) + abs(self.last)) + self.straight

    @property
    def goes_backward(self) -> bool:
        """Whether any piece is driven backward."""
        return min(self.first_direction, self.straight_direction, self.last_direction) < 0


def choose_path(goal: PlanarPose, radius: float, *, forward_only: bool = False) -> ArcPath | None:
    """Choose the shortest path from the origin to `goal`.

    Return None if the goal is nan or inf, or if `forward_only` excludes all paths.
    """
    best: ArcPath | None = None
    for path in ways(goal, radius):
        if forward_only and path.goes_backward:
            continue
        path = replace(path, first=_cleared(path.first), straight=_cleared(path.straight), last=_cleared(path.last))
        if best is None or path.length(radius) + _NEGLIGIBLE < best.length(radius):
            best = path
    return best


def _cleared(value: float) -> float:
    return 0.0 if abs(value) < _NEGLIGIBLE else value


def relative(goal: PlanarPose, start: PlanarPose) -> PlanarPose:
    """Convert `goal` to coordinates of `start`. The heading is not normalised."""
    x, y = goal.x - start.x, goal.y - start.y
    c, s = cosine(start.th), sine(start.th)
    return PlanarPose(x * c + y * s, y * c - x * s, goal.th - start.th)


def ways(goal: PlanarPose, radius: float) -> Iterator[ArcPath]:
    """Yield every path from the origin to `goal`."""
    if radius < _EXACT:
        # Turn on the spot, drive, turn on the spot.
        heading = math.atan2(goal.y, goal.x)
        yield ArcPath(heading, 1, math.sqrt(goal.x**2 + goal.y**2), 1, goal.th - heading, 1)
        return
    for side in (1, -1):
        start = (0.0, radius * side)
        for end_side in (1, -1):
            end = (goal.x - end_side * radius * sine(goal.th), goal.y + end_side * radius * cosine(goal.th))
            for leave, arrive in _tangents(start, end, radius, is_same_side=side == end_side):
                yield from _around(start, end, leave, arrive, goal, radius, side)


_Point = tuple[float, float]


def _distance(a: _Point, b: _Point) -> float:
    return math.sqrt((b[0] - a[0]) ** 2 + (b[1] - a[1]) ** 2)


def _direction(a: _Point, b: _Point) -> float:
    return math.atan2(b[1] - a[1], b[0] - a[0])


def _tangents(start: _Point, end: _Point, radius: float, *, is_same_side: bool) -> Iterator[tuple[_Point, _Point]]:
    """Yield both end points of each tangent: outer tangents on the same side, otherwise inner ones."""
    apart, between = _distance(start, end), _direction(start, end)
    if is_same_side:
        if apart > _EXACT:
            for sign in (1, -1):
                dx, dy = -sign * radius * sine(between), sign * radius * cosine(between)
                yield (start[0] + dx, start[1] + dy), (end[0] + dx, end[1] + dy)
        else:  # the same circle
            yield (0.0, 0.0), (0.0, 0.0)
    elif apart >= 2 * radius + _EXACT:
        for sign in (1, -1):
            angle = between + sign * math.acos(2 * radius / apart)
            dx, dy = radius * cosine(angle), radius * sine(angle)
            yield (start[0] + dx, start[1] + dy), (end[0] - dx, end[1] - dy)
    elif abs(apart - 2 * radius) < _EXACT:  # they touch
        touch = ((start[0] + end[0]) / 2, (start[1] + end[1]) / 2)
        yield touch, touch


def _around(
    start: _Point, end: _Point, leave: _Point, arrive: _Point, goal: PlanarPose, radius: float, side: int
) -> Iterator[ArcPath]:
    """Yield the paths along one tangent, in both directions round each circle."""
    straight = _distance(leave, arrive)
    if straight < _EXACT:
        straight, direction = 0.0, 0
        end_side = -side if abs(_distance(start, end) - 2 * radius) < _EXACT else side
    else:
        psi = _direction(leave, arrive)
        if abs(leave[0]) > _EXACT and abs(psi) > _EXACT:
            direction = side * _sign(psi) * _sign(leave[0])
        else:
            direction = side * _sign(cosine(psi)) * _sign(start[1] - leave[1])
        end_side = direction * _sign(_wrapped(_direction(leave, end) - psi))
    first = _direction(start, leave) - _direction(start, (0.0, 0.0))
    last = _direction(end, (goal.x, goal.y)) - _direction(end, arrive)
    for turn_first in _both_ways(first):
        for turn_last in _both_ways(last):
            yield ArcPath(
                side * abs(turn_first),
                _sign(turn_first) * side,
                straight,
                direction,
                end_side * abs(turn_last),
                _sign(turn_last) * end_side,
            )


def _both_ways(angle: float) -> Iterator[float]:
    """Yield an angle round a circle: the shorter one, then the longer one unless it is a full turn."""
    short = _wrapped(0.0 if abs(angle) < _EXACT else angle)
    yield short
    if abs(short) >= _EXACT:
        yield short + math.tau if short <= 0.0 else short - math.tau


def _wrapped(angle: float) -> float:
    if angle > math.pi:
        return angle - math.tau
    return angle + math.tau if angle <= -math.pi else angle


def _sign(value: float) -> int:
    return (value > 0.0) - (value < 0.0)


#: Distance before the end at which the straight piece ends, in m. An arc ends when its angle is exceeded.
_TOLERANCE = 0.0005


class NoWay(ValueError):
    """Error: there is no path to the goal, or every path goes backward."""


class DriveToPoint(ControlledMotion):
    """Motion along an arc, a line and an arc. The path is planned once, and the goal is not checked again.

    The motion ends at full speed unless the last piece changes the direction. It ends a few centimetres and degrees
    away from the goal.

    Args:
        goal: Goal pose in m, m and rad.
        radius: Radius of the arcs, in m.
        is_absolute: Whether the goal is in odometry coordinates; otherwise it is relative to the robot.
    """

    def __init__(self, goal: PlanarPose, radius: float, *, is_absolute: bool = False) -> None:
        self._goal = goal
        self._radius = radius
        self._is_absolute = is_absolute
        # Lengths of the arc, the line and the arc, in m.
        self._lengths = [0.0, 0.0, 0.0]
        # Pieces that are not driven yet, each with its direction; None for a missing piece.
        self._pieces: list[tuple[ControlledMotion | None, float]] = []
        self._is_begun = False

    def begin(self, control: MotionControl) -> None:
        """Plan the path.

        Raises:
            NoWay: If `evaluation` is 1 and every path goes backward, or if the goal is not a number.
        """
        control.report("\ndtp: Generating feasible paths...")
        goal = relative(self._goal, control.pose) if self._is_absolute else self._goal
        control.report("\ndtp: Choosing the optimal path...")
        forward_only = control.profile.topoint_evaluates and control.parameters.evaluation == 1.0
        control.report(f"\ndtp_evalmethod = DTP_EVAL_SHORTEST{'_NOBACK' * forward_only}")
        path = choose_path(goal, self._radius, forward_only=forward_only)
        if path is None:
            raise NoWay("there is no path to the goal" + " without driving backward" * forward_only)
        control.report("\ndtp: Starting movement...")
        control.target = control.pose.copy()
        self._lengths = [self._radius * abs(path.first), path.straight, self._radius * abs(path.last)]
        turns_back = path.straight_direction * path.last_direction == -1
        straight: ControlledMotion = (
            Forward(path.straight_direction * path.straight) if turns_back else FollowDirection()
        )
        # Each piece, and the direction of its speed. If the path turns back, the straight piece is a `fwd`, which slows
        # down before the turning point; the sign of its distance gives its direction.
        self._pieces = [
            (ArcTurn(self._radius, path.first, is_piece=True) if path.first else None, path.first_direction),
            (straight if path.straight else None, 1 if turns_back else path.straight_direction),
            (ArcTurn(self._radius, path.last, is_piece=True) if path.last else None, path.last_direction),
        ]
        self._is_begun = False

    def update(self, control: MotionControl) -> None:
        """Continue along the current piece."""
        if not self._pieces:
            return
        piece, direction = self._pieces[0]
        if piece is None:
            # A missing piece takes one cycle.
            self._pieces.pop(0)
            self._check_end(control)
            return
        speed, profile = control.speed, control.profile
        if not self._is_begun or profile.topoint_is_signed:
            control.speed = direction * abs(control.speed)
        if not self._is_begun:
            self._is_begun = True
            if isinstance(piece, FollowDirection):
                control.reference.set(control.pose.x, control.pose.y, control.pose.th)
                if profile.topoint_is_signed:
                    control.distance = 0.0
            piece.begin(control)
        piece.update(control)
        if profile.topoint_is_signed:
            control.speed = speed
        if self._is_over(piece, control):
            control.target = control.pose.copy()
            self._pieces.pop(0)
            self._is_begun = False
            self._check_end(control)

    def _is_over(self, piece: ControlledMotion, control: MotionControl) -> bool:
        if isinstance(piece, FollowDirection):
            return self._lengths[1] - abs(control.remaining) < _TOLERANCE
        if isinstance(piece, Forward):
            return (control.remaining if control.distance >= 0.0 else -control.remaining) < _TOLERANCE
        return piece.is_done(control)

    def _check_end(self, control: MotionControl) -> None:
        if not self._pieces and control.profile.turnr_ends:
            control.finish()

    def is_done(self, control: MotionControl) -> bool:
        """Whether all three pieces are driven."""
        return not self._pieces

    def progress(self, control: MotionControl) -> float:
        """Finished part, from the lengths of the pieces."""
        lengths = self._lengths
        whole = sum(lengths)
        if not self._pieces or not whole:
            return 1.0
        present = 3 - len(self._pieces)
        piece = self._pieces[0][0]
        part = 0.0
        if self._is_begun and isinstance(piece, FollowDirection):
            part = abs(control.remaining) / lengths[1]
        elif self._is_begun and piece is not None:
            part = piece.progress(control)
        return (sum(lengths[:present]) + part * lengths[present]) / whole

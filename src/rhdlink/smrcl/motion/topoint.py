"""`drivetopoint`: to a pose, along an arc, a straight line and an arc."""

from __future__ import annotations

from ..odometry import Pose
from .control import Motion, MotionControl
from .path import Path, choose_path, relative
from .straight import FollowDirection, Forward
from .turning import Arc

__all__ = ["DriveToPoint", "NoWay"]

#: m before the end at which the straight piece ends; that of an arc is when the angle is exceeded.
_TOLERANCE = 0.0005

_NOTHING = Path(0.0, 0, 0.0, 0, 0.0, 0)


class NoWay(ValueError):
    """There is no way to the goal, or none that does not go backward."""


class DriveToPoint(Motion):
    """Three motions in a row, planned when the motion begins and driven without looking at the goal again.

    It ends at full speed unless the last piece changes the direction, a few centimetres and degrees off.

    Args:
        goal: m, m, rad.
        radius: of the arcs, m.
        is_absolute: the goal is in odometry coordinates, else seen from the robot.
    """

    def __init__(self, goal: Pose, radius: float, *, is_absolute: bool = False) -> None:
        self._goal = goal
        self._radius = radius
        self._is_absolute = is_absolute
        self._path = _NOTHING
        self._pieces: list[tuple[Motion | None, float]] = []
        self._is_begun = False

    def begin(self, control: MotionControl) -> None:
        """Plan.

        Raises:
            NoWay: `evaluation` is 1, and every way goes backward; or the goal is no number.
        """
        control.say("\ndtp: Generating feasible paths...")
        goal = relative(self._goal, control.pose) if self._is_absolute else self._goal
        control.say("\ndtp: Choosing the optimal path...")
        forward_only = control.profile.topoint_evaluates and control.parameters.evaluation == 1.0
        control.say(f"\ndtp_evalmethod = DTP_EVAL_SHORTEST{'_NOBACK' * forward_only}")
        path = choose_path(goal, self._radius, forward_only=forward_only)
        if path is None:
            raise NoWay("there is no way to the goal" + " without driving backward" * forward_only)
        control.say("\ndtp: Starting movement...")
        control.target = control.pose.copy()
        self._path = path
        turns_back = path.straight_direction * path.last_direction == -1
        straight: Motion = Forward(path.straight_direction * path.straight) if turns_back else FollowDirection()
        # A piece and the direction of the speed in it. Slowing down before the way turns back is left to `fwd`, which
        # has its direction in its distance.
        self._pieces = [
            (Arc(self._radius, path.first, is_piece=True) if path.first else None, path.first_direction),
            (straight if path.straight else None, 1 if turns_back else path.straight_direction),
            (Arc(self._radius, path.last, is_piece=True) if path.last else None, path.last_direction),
        ]
        self._is_begun = False

    def update(self, control: MotionControl) -> None:
        """Drive on along the present piece."""
        if not self._pieces:
            return
        piece, direction = self._pieces[0]
        if piece is None:
            # A cycle goes by for a piece that is not there.
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

    def _is_over(self, piece: Motion, control: MotionControl) -> bool:
        if isinstance(piece, FollowDirection):
            return self._path.straight - abs(control.remaining) < _TOLERANCE
        if isinstance(piece, Forward):
            return (control.remaining if control.distance >= 0.0 else -control.remaining) < _TOLERANCE
        return piece.is_done(control)

    def _check_end(self, control: MotionControl) -> None:
        if not self._pieces and control.profile.turnr_ends:
            control.finish()

    def is_done(self, control: MotionControl) -> bool:
        """When all three are driven."""
        return not self._pieces

    def progress(self, control: MotionControl) -> float:
        """By the lengths of the pieces."""
        path = self._path
        lengths = [self._radius * abs(path.first), path.straight, self._radius * abs(path.last)]
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

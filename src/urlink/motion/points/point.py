"""`Point`: a taught position of the arm with its TCP, and the checks before the arm moves to a point."""

from __future__ import annotations

import math
from dataclasses import dataclass
from datetime import datetime, timezone
from typing import TYPE_CHECKING, Literal, get_args

import numpy as np

from linkcore.arguments import check_choice
from linkcore.errors import BadValue

from ...arm.bounds import TOOL_LENGTH, check_pose
from ...arm.models import indistinguishable
from ...arm.vectors import FloatArray, six

if TYPE_CHECKING:
    from ...arm.kinematics import Arm

#: What a motion to a point keeps if the TCP has changed since the point was taught: "pose" moves the current TCP to the
#: taught pose, "joints" moves the arm to the taught joint positions.
KeepName = Literal["pose", "joints"]

#: Smallest change of the TCP, in m and in rad, that counts as a change. The controller and the kinematics of a
#: calibrated arm agree to less than 1e-9 m, and no tool is mounted this precisely.
_TCP_MOVED, _TCP_TURNED = 1e-4, 1e-3
#: Largest difference, in m and in rad, between the taught pose and the pose at the taught joint positions. The
#: calibrations of two arms of one model differ by a few mm, so a larger difference means that the point was edited.
_APART, _TWISTED = 0.02, 0.05
#: Smallest motion of a joint, in rad, that counts as a change of the configuration. Close to a singularity, the
#: configuration can change with a small motion.
_FLIP = 0.5


@dataclass(frozen=True, eq=False)
class Point:
    """Taught position of the arm. Two points are equal if all their values are equal.

    Attributes:
        q: Joint positions, shape (6,), in rad. Read-only.
        pose: Pose of the TCP in the base frame, shape (6,), in m and rad. Read-only.
        tcp: Pose of the TCP in the flange frame when the point was taught, shape (6,), in m and rad. Read-only.
        model: Name of the arm, such as "UR5e".
        date: Time of teaching, in UTC.

    Raises:
        BadValue: If a value has the wrong type, shape or range, or if `date` has no time zone.
    """

    q: FloatArray
    pose: FloatArray
    tcp: FloatArray
    model: str
    date: datetime

    def __post_init__(self) -> None:
        if not isinstance(self.model, str) or not self.model.strip():
            raise BadValue(f"model is {self.model!r}; expected the name of an arm, such as 'UR5e'")
        if not isinstance(self.date, datetime) or self.date.utcoffset() is None:
            raise BadValue(f"date is {self.date!r}; expected a datetime with a time zone")
        try:
            date = self.date.astimezone(timezone.utc)
        except OverflowError:
            raise BadValue(f"date is {self.date!r}; expected a date from year 1 to 9999 in UTC") from None
        checked = {
            "q": six(self.q, "q"),
            "pose": check_pose(self.pose, "pose"),
            "tcp": check_pose(self.tcp, "tcp", TOOL_LENGTH),
            "date": date,
        }
        vars(self).update(checked)  # bypasses the frozen dataclass

    def _values(self) -> tuple[object, ...]:
        return (*self.q.tolist(), *self.pose.tolist(), *self.tcp.tolist(), self.model, self.date)

    def __eq__(self, other: object) -> bool:
        return self._values() == other._values() if isinstance(other, Point) else NotImplemented

    def __hash__(self) -> int:
        return hash(self._values())


@dataclass(frozen=True)
class PointCheck:
    """Result of `Points.check`: whether the current TCP reaches a taught pose.

    Attributes:
        name: Name of the point.
        verdict: "unchanged" if the TCP is the same as when the point was taught. "reachable" if the TCP has changed,
            and still reaches the taught pose in the taught configuration. "unreachable" if it does not. "refused" if
            the point cannot be used on this arm at all.
        reason: Why the point is unreachable or refused; empty otherwise.
        moved: Distance in m between the origins of the taught and the current TCP.
        turned: Angle in rad between the taught and the current TCP.
        q: Joint positions at which the current TCP is at the taught pose, shape (6,), in rad; None if there are none.
        largest: Largest difference of a joint between `q` and the taught joint positions, in rad; 0 without `q`.
    """

    name: str
    verdict: Literal["unchanged", "reachable", "unreachable", "refused"]
    reason: str = ""
    moved: float = 0.0
    turned: float = 0.0
    q: FloatArray | None = None
    largest: float = 0.0

    @property
    def is_reachable(self) -> bool:
        """Whether the current TCP reaches the taught pose."""
        return self.verdict in ("unchanged", "reachable")


# -- moving to a point -------------------------------------------------------------------------------


def check_keep(keep: object) -> None:
    """Raise `BadValue` unless `keep` is None or a `KeepName`."""
    if keep is not None:
        check_choice(keep, "keep", get_args(KeepName))


def check_taught_on(point: Point, arm: Arm) -> None:
    """Check that a point belongs to an arm.

    Raises:
        BadValue: If the point was taught on another model, if its joint positions and its pose contradict each other,
            or if a joint position exceeds the limits of the arm.
    """
    if point.model not in {each.name for each in indistinguishable(arm.model)}:
        raise BadValue(f"the point was taught on a {point.model}, but this arm is a {arm.model.name}")
    moved, turned = difference(arm.forward(point.q, point.tcp), point.pose)
    if moved > _APART or turned > _TWISTED:
        raise BadValue(
            f"the joint positions and the pose of the point differ by {_size(moved, turned)} on this arm; expected the "
            "same position of the TCP (was the point edited?)"
        )
    arm.model.check_joints(point.q)


def goal_joints(point: Point, keep: KeepName | None, arm: Arm, tcp: FloatArray) -> FloatArray:
    """Return the joint positions of a motion to a point, shape (6,), in rad.

    Args:
        point: Goal of the motion.
        keep: See `KeepName`. None refuses the motion if the TCP has changed.
        arm: Kinematics of the robot.
        tcp: Current TCP in the flange frame.

    Raises:
        BadValue: If the point does not belong to the arm, or if the TCP has changed and `keep` is None.
        Unreachable: If the current TCP does not reach the taught pose in the taught configuration.
    """
    return reached(point, arm, tcp) if _kept(point, keep, arm, tcp) == "pose" else point.q


def goal_pose(point: Point, keep: KeepName | None, arm: Arm, tcp: FloatArray) -> FloatArray:
    """Return the pose of a motion to a point, shape (6,), in m and rad. See `goal_joints`."""
    kept = _kept(point, keep, arm, tcp)
    if kept == "joints":
        return arm.forward(point.q, tcp)
    if kept == "pose":
        reached(point, arm, tcp)
    return point.pose


def _kept(point: Point, keep: KeepName | None, arm: Arm, tcp: FloatArray) -> KeepName | None:
    """Return which part of the point to keep; None if the TCP is unchanged."""
    check_keep(keep)
    check_taught_on(point, arm)
    moved, turned = difference(point.tcp, tcp)
    if not has_changed(moved, turned):
        return None
    if keep is None:
        raise BadValue(
            f"the TCP has changed by {_size(moved, turned)} since the point was taught on {point.date:%Y-%m-%d}; pass "
            "keep='pose' to move the current TCP to the taught pose, keep='joints' to move to the taught joint "
            "positions, or teach the point again"
        )
    return keep


def reached(point: Point, arm: Arm, tcp: FloatArray) -> FloatArray:
    """Return the joint positions closest to the taught ones at which `tcp` is at the taught pose, shape (6,), in rad.

    Raises:
        Unreachable: If there are none, or only in another configuration of the arm (shoulder, elbow or wrist flipped).
        BadValue: If a joint exceeds its limits.
    """
    from ...arm.kinematics import Unreachable

    found = arm.solutions(point.pose, point.q, tcp)
    if not len(found):
        arm.inverse(point.pose, point.q, tcp)  # raises the error that names the distance
    taught = configuration(arm, point.q)
    same = [q for q in found if np.abs(q - point.q).max() <= _FLIP or configuration(arm, q) == taught]
    if not same:
        raise Unreachable(
            "the current TCP reaches the taught pose only in another configuration of the arm than the taught one; "
            "teach the point again"
        )
    nearest = same[0]  # the solutions are in the order of their largest joint motion
    low, high = arm.position_limits.T
    q = six(np.where(nearest > high, nearest - math.tau, np.where(nearest < low, nearest + math.tau, nearest)), "q")
    arm.model.check_joints(q)
    return q


def configuration(arm: Arm, q: FloatArray) -> tuple[bool, bool, bool]:
    """Return the configuration of an arm: shoulder, wrist and elbow, as the rows of `Arm.branches` are numbered."""
    frames = arm.frames(q)
    is_away = bool(frames[1][:3, 0] @ frames[5][:3, 3] < 0.0)
    return is_away, math.remainder(q[4], math.tau) < 0.0, math.remainder(q[2], math.tau) < 0.0


def difference(first: FloatArray, second: FloatArray) -> tuple[float, float]:
    """Return the distance in m and the angle in rad between two poses."""
    from ...arm.poses import compose, invert

    between = compose(invert(first), second)
    return float(np.linalg.norm(between[:3])), float(np.linalg.norm(between[3:]))


def has_changed(moved: float, turned: float) -> bool:
    """Whether a difference between two TCPs, in m and rad, counts as a change."""
    return moved > _TCP_MOVED or turned > _TCP_TURNED


def _size(moved: float, turned: float) -> str:
    return f"{moved * 1e3:.1f} mm and {math.degrees(turned):.1f} degrees"

"""Goals of `FollowJointTrajectory` as trajectories of the library."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from urlink import BadValue, Cancelled, LinkError, LinkTimeout, ToleranceExceeded, Trajectory

__all__ = ["Goal", "error_code", "read_goal", "seconds"]

#: rad and s, where a goal does not say; as `urlink.Motions.follow`.
_GOAL_TOLERANCE, _GOAL_TIME = 0.01, 1.0


@dataclass(frozen=True)
class Goal:
    """What is to be followed, and how closely.

    Attributes:
        trajectory: what to follow.
        path_tolerance: rad; None for any distance.
        goal_tolerance: rad.
        goal_time: s.
    """

    trajectory: Trajectory
    path_tolerance: float | None
    goal_tolerance: float
    goal_time: float


def read_goal(message: Any, joints: Sequence[str], here: Any) -> Goal:
    """A goal as it came, its joints in the order of the arm.

    Where the first point is not at time 0, the trajectory begins where the arm is. The library has one tolerance for
    all joints: the strictest that is given. As the message has it, 0 is the default and -1 none.

    Args:
        message: of the type `FollowJointTrajectory.Goal`.
        joints: names, base to wrist 3.
        here: (6,) rad, where the arm is led.

    Raises:
        BadValue: other joints, velocities for some points only, or what `Trajectory` refuses.
    """
    names = list(message.trajectory.joint_names)
    if sorted(names) != sorted(joints):
        raise BadValue(f"joint_names={names}; expected {list(joints)}, in any order")
    order = [names.index(joint) for joint in joints]

    def column(name: str) -> list[list[float]] | None:
        rows = [list(getattr(point, name)) for point in message.trajectory.points]
        if not any(rows):
            return None
        for number, row in enumerate(rows):
            if len(row) != len(order):
                raise BadValue(f"point {number}: {len(row)} {name}; expected {len(order)}, in all points or in none")
        return [[row[joint] for joint in order] for row in rows]

    times = [seconds(point.time_from_start) for point in message.trajectory.points]
    q, qd, qdd = column("positions"), column("velocities"), column("accelerations")
    if q is None:
        raise BadValue("a trajectory without positions")
    if times[0] > 0.0:
        times.insert(0, 0.0)
        q.insert(0, [float(value) for value in here])
        for rest in (qd, qdd):
            if rest is not None:
                rest.insert(0, [0.0] * len(order))
    # Points that have accelerations without velocities leave both to be chosen.
    trajectory = Trajectory.from_arrays(times, q, qd, None if qd is None else qdd)
    goal_time = seconds(message.goal_time_tolerance)
    return Goal(
        trajectory,
        _strictest(message.path_tolerance, None),
        _strictest(message.goal_tolerance, _GOAL_TOLERANCE) or 100.0,
        goal_time if goal_time > 0.0 else _GOAL_TIME,
    )


def _strictest(tolerances: Sequence[Any], default: float | None) -> float | None:
    given = [tolerance.position for tolerance in tolerances]
    if any(value > 0.0 for value in given):
        return float(min(value for value in given if value > 0.0))
    return None if any(value < 0.0 for value in given) else default


def seconds(duration: Any) -> float:
    """Of the message `Duration`."""
    return float(duration.sec + 1e-9 * duration.nanosec)


def error_code(error: Exception, result: Any, is_at_the_end: bool) -> int:
    """The code of `FollowJointTrajectory.Result` for what ended a motion, or refused it.

    Args:
        error: of the library.
        result: the type of the message, which has the codes.
        is_at_the_end: the trajectory was over, and the arm on its way to the goal.
    """
    if isinstance(error, (ToleranceExceeded, LinkTimeout)):
        return int(result.GOAL_TOLERANCE_VIOLATED if is_at_the_end else result.PATH_TOLERANCE_VIOLATED)
    if isinstance(error, Cancelled) or not isinstance(error, LinkError):
        return int(result.INVALID_GOAL)
    if isinstance(error, BadValue) and "joint_names" in str(error):
        return int(result.INVALID_JOINTS)
    return int(result.INVALID_GOAL)

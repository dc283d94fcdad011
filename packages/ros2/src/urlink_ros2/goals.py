"""Conversion of `FollowJointTrajectory` goals to trajectories of urlink."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from urlink import (
    BadValue,
    Cancelled,
    ConnectionLost,
    LinkError,
    LinkTimeout,
    LocalError,
    NotRunning,
    ProgramStopped,
    SafetyStop,
    ToleranceExceeded,
    Trajectory,
)

__all__ = ["Goal", "Late", "has_passed", "outcome", "read_goal", "seconds", "start_of"]

#: Default tolerance, in rad, and time, in s, at the goal; the same as in `urlink.motion.Motions.follow`.
_GOAL_TOLERANCE, _GOAL_TIME = 0.01, 1.0
#: Maximum distance of a joint, in rad, from a trajectory that should already have started; as in `Motions.follow`.
_START_TOLERANCE = 0.05

#: Codes of results for which `FollowJointTrajectory` has no code: it defines 0 to -5.
STOPPED, LINK_LOST, PREEMPTED, CANCELLED, FAILED = -101, -102, -103, -104, -105


class Late(BadValue):
    """Goal that is too late according to its `header.stamp`."""


@dataclass(frozen=True)
class Goal:
    """Trajectory of a goal, and its tolerances.

    Attributes:
        trajectory: Trajectory to follow.
        path_tolerance: Tolerance along the path, in rad; None for no limit.
        goal_tolerance: Tolerance at the end, in rad.
        goal_time: Maximum time to reach the goal after the end of the trajectory, in s.
    """

    trajectory: Trajectory
    path_tolerance: float | None
    goal_tolerance: float
    goal_time: float


def start_of(message: Any) -> float | None:
    """Return the start time of a goal, in s of the ROS clock, from `header.stamp`; None for now."""
    stamp = message.trajectory.header.stamp
    return seconds(stamp) if stamp.sec or stamp.nanosec else None


def has_passed(message: Any, now: float) -> bool:
    """Whether a goal would already have ended, according to its `header.stamp`.

    joint_trajectory_controller rejects such a goal too.
    """
    start, points = start_of(message), message.trajectory.points
    return start is not None and bool(points) and start + seconds(points[-1].time_from_start) < now


def read_goal(message: Any, joints: Sequence[str], here: Any, passed: float = 0.0) -> Goal:
    """Read a goal, and put its joints in the order of the arm.

    If the first point is not at time 0, the trajectory starts at the current set-point of the arm. urlink has one
    tolerance for all joints, so the strictest one is used. As the message defines, 0 selects the default and -1 means
    no tolerance.

    Points whose time has passed are left out, as in joint_trajectory_controller. That controller continues from the
    current point of the trajectory, and jumps if the arm is elsewhere. Here, the goal is rejected instead.

    Args:
        message: Message of the type `FollowJointTrajectory.Goal`.
        joints: Names of the joints, base to wrist 3.
        here: Current set-point of the joints, shape (6,), in rad.
        passed: Time since the goal should have started, in s.

    Raises:
        Late: If the arm is not at the current point of the trajectory.
        BadValue: If the joint names are not those of the arm, if only some points have velocities, or if `Trajectory`
            rejects the points.
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
                raise BadValue(
                    f"point {number} has {len(row)} {name}; expected {len(order)}, because another point has {name}"
                )
        return [[row[joint] for joint in order] for row in rows]

    times = [seconds(point.time_from_start) for point in message.trajectory.points]
    q, qd, qdd = column("positions"), column("velocities"), column("accelerations")
    if q is None:
        raise BadValue("the trajectory has no positions; expected positions in all points")
    begins = times[0]
    if begins > 0.0:
        times.insert(0, 0.0)
        q.insert(0, [float(value) for value in here])
        for rest in (qd, qdd):
            if rest is not None:
                rest.insert(0, [0.0] * len(order))
    # Accelerations without velocities are not used; the trajectory chooses both.
    trajectory = Trajectory.from_arrays(times, q, qd, None if qd is None else qdd)
    if passed > 0.0:
        if passed > begins:
            off = float(np.abs(np.array(trajectory.sample(passed)[0]) - here).max())
            if passed >= trajectory.duration or off > _START_TOLERANCE:
                raise Late(
                    f"header.stamp was {passed:.2f} s ago, and the arm is {off:.3f} rad from the current point of the "
                    f"trajectory; expected at most {_START_TOLERANCE:g} rad"
                )
        left = [number for number, at in enumerate(times) if at > passed]
        start, rest = [[float(value) for value in here]], [[0.0] * len(order)]
        trajectory = Trajectory.from_arrays(
            [0.0, *(times[number] - passed for number in left)],
            start + [q[number] for number in left],
            None if qd is None else rest + [qd[number] for number in left],
            None if qd is None or qdd is None else rest + [qdd[number] for number in left],
        )
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
    """Convert a `Duration` message to s."""
    return float(duration.sec + 1e-9 * duration.nanosec)


def outcome(error: Exception, result: Any, is_at_the_end: bool, is_preempted: bool) -> tuple[int, str]:
    """Return the code of a result, and the prefix of its text, for an error of a motion.

    Args:
        error: Error that ended or refused the motion.
        result: Type of the message, which defines the codes.
        is_at_the_end: Whether the time of the trajectory had passed, and the arm was still moving to the goal.
        is_preempted: Whether a newer goal has replaced this one.
    """
    if isinstance(error, ToleranceExceeded):
        if is_at_the_end:
            return int(result.GOAL_TOLERANCE_VIOLATED), "GOAL_TOLERANCE_VIOLATED"
        return int(result.PATH_TOLERANCE_VIOLATED), "PATH_TOLERANCE_VIOLATED"
    if isinstance(error, Late):
        return int(result.OLD_HEADER_TIMESTAMP), "OLD_HEADER_TIMESTAMP"
    if isinstance(error, BadValue) and "joint_names" in str(error):
        return int(result.INVALID_JOINTS), "INVALID_JOINTS"
    if isinstance(error, (SafetyStop, NotRunning, ProgramStopped)):
        return STOPPED, "STOPPED"
    if isinstance(error, (ConnectionLost, LinkTimeout)):
        return LINK_LOST, "LINK_LOST"
    if isinstance(error, Cancelled):
        return (PREEMPTED, "PREEMPTED") if is_preempted else (CANCELLED, "CANCELLED")
    if isinstance(error, LocalError) or not isinstance(error, LinkError):
        return int(result.INVALID_GOAL), "INVALID_GOAL"
    return FAILED, "FAILED"

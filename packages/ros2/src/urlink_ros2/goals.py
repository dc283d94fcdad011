"""Goals of `FollowJointTrajectory` as trajectories of the library."""

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

#: rad and s, where a goal does not say; as `urlink.motion.Motions.follow`.
_GOAL_TOLERANCE, _GOAL_TIME = 0.01, 1.0
#: rad that a joint may be off where a trajectory begins that should have begun before; as `Motions.follow`.
_START_TOLERANCE = 0.05

#: Codes of a result that `FollowJointTrajectory` has none for: it has those from 0 to -5.
STOPPED, LINK_LOST, PREEMPTED, CANCELLED, FAILED = -101, -102, -103, -104, -105


class Late(BadValue):
    """A goal whose time, by its `header.stamp`, has passed."""


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


def start_of(message: Any) -> float | None:
    """When a goal is to begin, in seconds of the clock of ROS: its `header.stamp`; None for at once."""
    stamp = message.trajectory.header.stamp
    return seconds(stamp) if stamp.sec or stamp.nanosec else None


def has_passed(message: Any, now: float) -> bool:
    """Whether a goal would have ended before now, by its `header.stamp`; as joint_trajectory_controller rejects it."""
    start, points = start_of(message), message.trajectory.points
    return start is not None and bool(points) and start + seconds(points[-1].time_from_start) < now


def read_goal(message: Any, joints: Sequence[str], here: Any, passed: float = 0.0) -> Goal:
    """A goal as it came, its joints in the order of the arm.

    Where the first point is not at time 0, the trajectory begins where the arm is. The library has one tolerance for
    all joints: the strictest that is given. As the message has it, 0 is the default and -1 none.

    Points whose time has passed are left out, as joint_trajectory_controller does. That goes on from where the
    trajectory is by now, and leaps if the arm is elsewhere; here the goal is refused then.

    Args:
        message: of the type `FollowJointTrajectory.Goal`.
        joints: names, base to wrist 3.
        here: (6,) rad, where the arm is led.
        passed: seconds since it should have begun.

    Raises:
        Late: the arm is not where the trajectory is by now.
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
    begins = times[0]
    if begins > 0.0:
        times.insert(0, 0.0)
        q.insert(0, [float(value) for value in here])
        for rest in (qd, qdd):
            if rest is not None:
                rest.insert(0, [0.0] * len(order))
    # Points that have accelerations without velocities leave both to be chosen.
    trajectory = Trajectory.from_arrays(times, q, qd, None if qd is None else qdd)
    if passed > 0.0:
        if passed > begins:
            off = float(np.abs(np.array(trajectory.sample(passed)[0]) - here).max())
            if passed >= trajectory.duration or off > _START_TOLERANCE:
                raise Late(
                    f"header.stamp was {passed:.2f} s ago, and the arm is {off:.3f} rad from where its trajectory is "
                    f"now; the tolerance is {_START_TOLERANCE:g} rad"
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
    """Of the message `Duration`."""
    return float(duration.sec + 1e-9 * duration.nanosec)


def outcome(error: Exception, result: Any, is_at_the_end: bool, is_preempted: bool) -> tuple[int, str]:
    """What ended a motion, or refused it: the code of the result, and what its text begins with.

    Args:
        error: of the library.
        result: the type of the message, which has the codes.
        is_at_the_end: the trajectory was over, and the arm on its way to the goal.
        is_preempted: a newer goal has taken its place.
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

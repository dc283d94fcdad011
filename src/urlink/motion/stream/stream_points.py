"""Points that a user passes to a stream, and their conversion to steps within the bounds of the arm."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from linkcore.arguments import check_seconds
from linkcore.errors import BadValue

from ...arm.bounds import check_pose
from ...arm.vectors import JOINTS, FloatArray
from ..moves.trajectory import LEAP, Trajectory, TrajectoryPoint
from .stream_steps import Aim, Bounds, JointMoment, Mark, Step

#: Largest distance in rad between the resting position of the arm and a first point with the same time.
_NEAR = 0.05
#: Longest time in s between two points. It is limited because a message contains this time in microseconds, as a 32-bit
#: integer.
_LONGEST = 1000.0


@dataclass(frozen=True, eq=False, init=False)
class PosePoint:
    """Pose of the tool at one time, as a point of a `PointStream`.

    The pose is converted to joint positions with the inverse kinematics of the arm.

    Attributes:
        pose: Position in the base frame in m, and rotation vector in rad, shape (6,); read-only.
        time: Time in s on the clock of the stream.

    Raises:
        BadValue: If `pose` is not six finite numbers, or if `time` is not a valid time.
    """

    pose: FloatArray
    time: float

    def __init__(self, pose: ArrayLike, time: float) -> None:
        object.__setattr__(self, "pose", check_pose(pose, "pose"))
        object.__setattr__(self, "time", check_seconds(time, "time", finite=True))


#: Points that a stream accepts: one point, several points, or a trajectory. The time of a trajectory is shifted to its
#: place in the stream.
Points = TrajectoryPoint | PosePoint | Trajectory | Iterable[TrajectoryPoint | PosePoint]


class PointReader:
    """Converter from points to steps. It compares the steps with the bounds of the arm.

    Args:
        bounds: Bounds of the arm.
        shortest: Shortest time between two points, in s.
        inverse: Inverse kinematics of the arm: a function of a pose and of previous joint positions. It returns the
            joint positions for the pose that are closest to the previous ones.
    """

    def __init__(
        self, bounds: Bounds, shortest: float, inverse: Callable[[FloatArray, FloatArray], FloatArray]
    ) -> None:
        self._bounds = bounds
        self._shortest = shortest
        self._inverse = inverse

    def after(self, points: Points, mark: Mark, begins: float = 0.0) -> list[Aim]:
        """Return the aims for points that are appended at the end of the stream.

        Args:
            points: The points.
            mark: End of the stream.
            begins: Earliest time at which a trajectory may begin, in s on the clock of the stream.

        Raises:
            BadValue: If the arm could not follow the points.
            Unreachable: If a pose is out of reach.
        """
        aims: list[Aim] = []
        begin, time = mark.moment, mark.time
        names = []
        for number, point in enumerate(self._given(points, max(begins, mark.time), mark)):
            name = f"point {number} (t = {point.time:g} s)"
            is_here = number == 0 and abs(point.time - time) < self._shortest
            if is_here and isinstance(points, Trajectory):
                self._check_near(name, point.q, begin.q)  # the trajectory continues from the end of the stream
                continue
            if is_here and begin.rests:
                self._check_near(name, point.q, begin.q)
                aims.append(Aim(time, _moment(point), None))
            else:
                aims.append(self._reached(name, point, begin, time))
                names.append(name)
            begin, time = aims[-1].moment, point.time
        self._check(aims, names)
        return aims

    def curve(self, points: Points, since: float, mark: Mark) -> list[Aim]:
        """Return the aims for points on a separate curve. The first aim has no step.

        A trajectory begins at `since`.

        Raises:
            BadValue, Unreachable: If `after` would raise this error.
        """
        aims: list[Aim] = []
        names = []
        for number, point in enumerate(self._given(points, since, mark)):
            name = f"point {number} (t = {point.time:g} s)"
            if not aims:
                aims.append(Aim(point.time, _moment(point), None))
            else:
                aims.append(self._reached(name, point, aims[-1].moment, aims[-1].time))
                names.append(name)
        self._check(aims, names)
        return aims

    def _check(self, aims: Sequence[Aim], names: Sequence[str]) -> None:
        steps = [aim.step for aim in aims if aim.step is not None]
        if not aims:
            raise BadValue("there are no points; expected at least one")
        if steps:
            self._bounds.check(steps, names)

    def _reached(self, name: str, point: TrajectoryPoint, begin: JointMoment, since: float) -> Aim:
        """Return the aim for a point: the point, and the step to it from the moment `begin` at the time `since`, in s.

        The degree of the step depends on the velocities and accelerations that the point has.
        """
        length = point.time - since
        if not since + self._shortest * (1.0 - 1e-6) <= point.time <= since + _LONGEST:
            raise BadValue(
                f"{name}: its time is {length:.6g} s after the previous point or the end of the stream; expected "
                f"{self._shortest:g} s (two cycles of the controller) to {_LONGEST:g} s"
            )
        degree = 1 if point.qd is None else 3 if point.qdd is None else 5
        step = Step.to(begin, _moment(point), length, degree)
        return Aim(point.time, step.end, step)

    def _check_near(self, name: str, q: FloatArray, here: FloatArray) -> None:
        away = np.abs(q - here)
        joint = int(away.argmax())
        if away[joint] > _NEAR:
            raise BadValue(
                f"{name}: {JOINTS[joint]} (joint {joint}) is at {q[joint]:.4f} rad, {away[joint]:.4f} rad from the "
                f"position of the arm; expected at most {_NEAR:g} rad, because it has no time to move there"
            )

    def _given(self, points: Points, begin: float, mark: Mark) -> list[TrajectoryPoint]:
        """Convert the points to points with joint positions and with times on the clock of the stream."""
        if isinstance(points, Trajectory):
            return self._of_trajectory(points, begin)
        given: list[Any] = [points] if isinstance(points, (TrajectoryPoint, PosePoint)) else _listed(points)
        near = mark.moment.q
        made = []
        for number, point in enumerate(given):
            if isinstance(point, PosePoint):
                near = self._joints(point, near, number)
                made.append(TrajectoryPoint(near, point.time))
            elif isinstance(point, TrajectoryPoint):
                near = point.q
                made.append(point)
            else:
                raise BadValue(f"point {number} is {point!r}; expected a TrajectoryPoint or a PosePoint")
            if made[-1].qdd is not None and made[-1].qd is None:
                raise BadValue(f"point {number} has accelerations without velocities; a quintic curve needs both")
        return made

    def _of_trajectory(self, trajectory: Trajectory, begin: float) -> list[TrajectoryPoint]:
        time, q, qd, qdd = trajectory.time, trajectory.q, trajectory.qd, trajectory.qdd
        if np.diff(time).min() < self._shortest:
            # The program reads a point only in every second cycle, so the trajectory is resampled. The curve hardly
            # changes.
            time = np.linspace(0.0, trajectory.duration, max(int(trajectory.duration / (2.0 * self._shortest)), 1) + 1)
            q, qd, accelerations = trajectory.at(time)
            qdd = accelerations if trajectory.is_quintic else None
        return [
            TrajectoryPoint(q[i], begin + t, qd[i], None if qdd is None else qdd[i])
            for i, t in enumerate(time.tolist())
        ]

    def _joints(self, point: PosePoint, near: FloatArray, number: int) -> FloatArray:
        q = self._inverse(point.pose, near)
        leaps = np.abs(q - near)
        joint = int(leaps.argmax())
        if leaps[joint] > LEAP:
            raise BadValue(
                f"point {number} (t = {point.time:g} s): {JOINTS[joint]} (joint {joint}) would jump from "
                f"{near[joint]:.4f} to {q[joint]:.4f} rad; expected at most {LEAP:g} rad: the pose is beyond a "
                "singularity, or too far away"
            )
        return q


def _listed(points: Any) -> list[Any]:
    try:
        return list(points)
    except TypeError:
        expected = "a sequence of TrajectoryPoint or PosePoint, or a Trajectory"
        raise BadValue(f"points is {points!r}; expected {expected}") from None


def _moment(point: TrajectoryPoint) -> JointMoment:
    rest = np.zeros(6)
    return JointMoment(point.q, rest if point.qd is None else point.qd, rest if point.qdd is None else point.qdd)

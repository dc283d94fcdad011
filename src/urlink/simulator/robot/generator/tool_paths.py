"""Paths of the tool along straight lines (movel, movep, servoc) and circles (movec), by the inverse kinematics."""

from __future__ import annotations

import math
from collections.abc import Sequence

from urlink import kinematics
from urlink.curves import Curve
from urlink.kinematics import Arm
from urlink.parameters import number
from urlink.poses import compose

from ..sources import Setpoint
from .joint_limits import JointLimits, LimitViolation

#: m that count as much as a turn of 1 rad, at least, so that a tool which turns in place takes its time. A guess.
RADIAN = number("metres_per_turn_simulated")

_REST = [0.0] * 6
# Samples of a path for its largest speed, and rad from one to the next that are a jump through a singularity.
_SAMPLES, _JUMP = 64, 0.5


def joints_at(arm: Arm, pose: Sequence[float], tcp: Sequence[float], near: Sequence[float]) -> list[float]:
    """The joint positions closest to `near` that put the TCP at a pose.

    Raises:
        LimitViolation: the pose is out of reach.
    """
    try:
        found: list[float] = arm.inverse(pose, near, tcp, is_limited=False).tolist()
    except kinematics.Unreachable:
        raise LimitViolation(f"the arm does not reach the pose {[round(number, 4) for number in pose]}") from None
    return found


def setpoint_at(arm: Arm, pose: Sequence[float], tcp: Sequence[float], last: Setpoint, seconds: float) -> Setpoint:
    """The joints at a pose of the TCP, one cycle after `last`; speeds and accelerations are differences.

    Raises:
        LimitViolation: the pose is out of reach.
    """
    q = joints_at(arm, pose, tcp, last.q)
    qd = [(new - old) / seconds for new, old in zip(q, last.q, strict=True)]
    return Setpoint(q, qd, [(new - old) / seconds for new, old in zip(qd, last.qd, strict=True)])


def moved(pose: Sequence[float], step: Sequence[float]) -> list[float]:
    """A pose that has gone on by a step in the directions of the base frame, m and rad."""
    place = [a + b for a, b in zip(pose[:3], step[:3], strict=True)]
    if not any(step[3:]):
        return [*place, *pose[3:]]
    turned: list[float] = compose((0.0, 0.0, 0.0, *step[3:]), (0.0, 0.0, 0.0, *pose[3:])).tolist()
    return place + turned[3:]


class ToolPath:
    """A path of the TCP along a curve, from close to the joint positions `near`.

    Attributes:
        length: m.
        end_pose: of the TCP at the end, m and rad.
    """

    def __init__(self, arm: Arm, limits: JointLimits, tcp: Sequence[float], curve: Curve, near: list[float]) -> None:
        self._kinematics, self._limits, self._tcp, self._curve, self._near = arm, limits, tcp, curve, near
        self.length = max(curve.length, RADIAN * curve.turn)
        self.end_pose = curve.end
        self._end_joints: list[float] | None = None

    def fastest(self) -> tuple[float, float]:
        """The largest speed and acceleration along the path at which no joint exceeds its limits, by samples of it.

        The part behind a singular posture, or out of reach, does not count: the arm does not get there.
        """
        part = self.length / _SAMPLES
        speed = acceleration = math.inf
        old = self._near
        for sample in range(1, _SAMPLES + 1):
            try:
                new = joints_at(self._kinematics, self._curve.pose(sample / _SAMPLES), self._tcp, old)
            except LimitViolation:
                break
            ways = [abs(b - a) for a, b in zip(old, new, strict=True)]
            if max(ways) > _JUMP:
                break
            for way, fastest, hardest in zip(ways, self._limits.speed, self._limits.acceleration, strict=True):
                if way > 0.0:
                    speed, acceleration = min(speed, fastest * part / way), min(acceleration, hardest * part / way)
            old = new
        return speed, acceleration

    def setpoint(self, way: float, speed: float, acceleration: float, last: Setpoint, seconds: float) -> Setpoint:
        """The joints after the distance `way`; `last` is the set-point of the cycle before.

        Raises:
            LimitViolation: the pose is out of reach.
        """
        if not speed and not acceleration:
            return Setpoint(last.q, _REST, _REST)
        return setpoint_at(self._kinematics, self._curve.pose(way / self.length), self._tcp, last, seconds)

    def end(self, near: Sequence[float]) -> list[float]:
        """The joints at the end, on the branch of the inverse kinematics that they come from.

        Raises:
            LimitViolation: the end is out of reach on this branch.
        """
        if self._end_joints is None:
            self._end_joints = joints_at(self._kinematics, self.end_pose, self._tcp, near)
        return self._end_joints

    def left(self, q: Sequence[float]) -> float:
        """Distance of the TCP from the end when the joints are at `q`, m."""
        return math.dist(self._kinematics.forward(q, self._tcp)[:3].tolist(), self.end_pose[:3])

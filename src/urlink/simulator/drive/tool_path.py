"""The joints along a path of the tool, by the analytic inverse kinematics."""

from __future__ import annotations

import math
from collections.abc import Sequence

from urlink.models import Model

from .. import kinematics
from ..motion import Setpoint
from .limits import LimitViolation, Unreachable

__all__ = ["RADIAN", "ToolPath", "joints_at", "rotated", "setpoint_at", "turn_between"]

#: m of a path that a turn of one radian is worth at least, so that a tool which turns in place takes its time. A guess.
RADIAN = 0.25

_REST = [0.0] * 6


def joints_at(model: Model, pose: Sequence[float], tcp: Sequence[float], near: Sequence[float]) -> list[float]:
    """The joint positions closest to `near` that put the TCP at a pose.

    Raises:
        Unreachable: there are none.
    """
    found = kinematics.inverse(model, pose, tcp, near)
    if not len(found):
        raise Unreachable(f"the arm does not reach the pose {[round(number, 4) for number in pose]}")
    nearest: list[float] = found[0].tolist()
    return nearest


def setpoint_at(model: Model, pose: Sequence[float], tcp: Sequence[float], last: Setpoint, seconds: float) -> Setpoint:
    """The joints at a pose of the TCP, one cycle after `last`; speeds and accelerations are differences.

    Raises:
        Unreachable: the arm does not reach the pose.
    """
    q = joints_at(model, pose, tcp, last.q)
    qd = [(new - old) / seconds for new, old in zip(q, last.q, strict=True)]
    return Setpoint(q, qd, [(new - old) / seconds for new, old in zip(qd, last.qd, strict=True)])


def turn_between(first: Sequence[float], second: Sequence[float]) -> list[float]:
    """The rotation vector, in the frame of the first pose, of the shortest turn to the second, rad."""
    turn: list[float] = kinematics.pose_trans(kinematics.pose_inv(first), second).tolist()[3:]
    return turn


def rotated(pose: Sequence[float], turn: Sequence[float], part: float) -> list[float]:
    """The rotation vector of a pose after part of a turn in its own frame."""
    if not any(turn):
        return list(pose[3:])
    x, y, z = turn
    turned: list[float] = kinematics.pose_trans(
        (0.0, 0.0, 0.0, *pose[3:]), (0.0, 0.0, 0.0, part * x, part * y, part * z)
    ).tolist()
    return turned[3:]


class ToolPath:
    """A path of the tool: what lines and circles share. Its length is in m.

    Attributes:
        length: m.
        speed, acceleration: those of the joints have no such limits: a joint that gets too fast is a violation.
    """

    speed = math.inf
    acceleration = math.inf

    def __init__(self, model: Model, tcp: Sequence[float], length: float, end: list[float], near: list[float]) -> None:
        self._model, self._tcp = model, tcp
        self.length = length
        self._end_pose = end
        self._end_joints: list[float] | None = None
        joints_at(model, end, tcp, near)

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
            return setpoint_at(self._model, self.pose(way / self.length), self._tcp, last, seconds)
        except Unreachable as error:
            raise LimitViolation(str(error)) from None

    def end(self, near: Sequence[float]) -> list[float]:
        """The joints at the end, by the branch of the inverse kinematics that they come from.

        Raises:
            LimitViolation: from there the arm does not reach it.
        """
        if self._end_joints is None:
            try:
                self._end_joints = joints_at(self._model, self._end_pose, self._tcp, near)
            except Unreachable as error:
                raise LimitViolation(str(error)) from None
        return self._end_joints

    def left(self, q: Sequence[float]) -> float:
        """How far the TCP is from its place at the end when the joints are at `q`, m."""
        return math.dist(kinematics.pose(self._model, q, self._tcp)[:3].tolist(), self._end_pose[:3])

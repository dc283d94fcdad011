"""Constant speeds: speedj and speedl; and stopj and stopl, which are speeds of zero.

The speed slider stretches the time of a speed: at a slider of 25 % it lasts four times as long, at a quarter of the
speed, and at 0 it does not end (the vendor's client library tests that a spline of such commands ends on its path).
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from urlink.kinematics import Arm
from urlink.poses import compose

from ..sources import Setpoint
from .joint_limits import JointLimits, LimitViolation, Unreachable
from .path_motion import Move
from .tool_paths import setpoint_at

__all__ = ["JointSpeed", "ToolSpeed"]

_REST = [0.0] * 6


class JointSpeed:
    """All joints change their speeds in proportion until each has its own, and keep it.

    Attributes:
        move: over after `t` s of scaled time; if `t` is None, when the speed is reached.
    """

    def __init__(self, qd: Sequence[float], acceleration: Sequence[float], t: float | None) -> None:
        """Six speeds, rad/s, and the largest acceleration of each joint, rad/s²."""
        self.move = Move()
        self._target, self._acceleration = list(qd), acceleration
        self._left = t
        self._stops = not any(qd)
        self.overrun = 0.0
        self.is_at_rest = False

    def advance(self, last: Setpoint, seconds: float, scaling: float, change: float) -> Setpoint:
        """The set-point one cycle later."""
        wanted = [scaling * v - old for v, old in zip(self._target, last.qd, strict=True)]
        part = 1.0
        for way, most in zip(wanted, self._acceleration, strict=True):
            if abs(way) > most * seconds * (1.0 + 1e-9):
                part = min(part, most * seconds / abs(way))
        is_reached = part == 1.0
        if is_reached:
            qd = [scaling * v for v in self._target] if not self._stops else _REST
        else:
            qd = [old + part * way for old, way in zip(last.qd, wanted, strict=True)]
        q = [a + 0.5 * seconds * (old + new) for a, old, new in zip(last.q, last.qd, qd, strict=True)]
        setpoint = Setpoint(q, qd, [(new - old) / seconds for new, old in zip(qd, last.qd, strict=True)])
        self.is_at_rest = self._stops and is_reached
        if self._left is None:
            self.move.is_over = is_reached
        else:
            self._left, self.overrun = _passed(self._left, scaling * seconds, seconds)
            self.move.is_over = self._left <= 0.0 and scaling > 0.0
        return setpoint


class ToolSpeed:
    """The tool changes its speed straight to another one, and keeps that.

    If it has to stop and the arm cannot continue along its line, because that ends or is singular there, the joints
    brake instead.

    Attributes:
        move: over after `t` s of scaled time; if `t` is None, when the speed is reached; for a stop, at rest.
    """

    def __init__(
        self,
        kinematics: Arm,
        limits: JointLimits,
        tcp: Sequence[float],
        begin: Setpoint,
        xd: Sequence[float],
        a: float,
        a_rot: float,
        t: float | None,
        old: ToolSpeed | None,
    ) -> None:
        """A speed of the TCP in m/s and rad/s in the base frame, and how fast it changes, in m/s² and rad/s².

        After an `old` one, the line continues exactly.
        """
        self.move = Move()
        self._kinematics, self._limits, self._tcp = kinematics, limits, list(tcp)
        self._target, self._a, self._a_rot, self._left = list(xd), a, a_rot, t
        self._pose: list[float] = kinematics.forward(begin.q, tcp).tolist()
        self._speed: list[float] = list(_REST)
        if old is not None and old._brake is None and old._tcp == self._tcp:
            self._speed = old._speed
        elif any(begin.qd):
            self._speed = kinematics.velocity(begin.q, begin.qd, tcp).tolist()
        self._stops = not any(xd)
        self._brake: JointSpeed | None = None
        self.overrun = 0.0
        self.is_at_rest = False

    def advance(self, last: Setpoint, seconds: float, scaling: float, change: float) -> Setpoint:
        """The set-point one cycle later.

        Raises:
            LimitViolation: the pose is out of reach.
        """
        if self._brake is not None:
            return self._braking(self._brake, last, seconds)
        if self._stops and not any(self._speed):
            self.is_at_rest = self.move.is_over = True
            return Setpoint(last.q, _REST, _REST)
        target = [scaling * v for v in self._target]
        line, line_reached = _towards(self._speed[:3], target[:3], self._a * seconds)
        turn, turn_reached = _towards(self._speed[3:], target[3:], self._a_rot * seconds)
        speed = line + turn
        step = [0.5 * seconds * (old + new) for old, new in zip(self._speed, speed, strict=True)]
        pose = [a + b for a, b in zip(self._pose[:3], step[:3], strict=True)]
        if any(step[3:]):
            pose += compose((0.0, 0.0, 0.0, *step[3:]), (0.0, 0.0, 0.0, *self._pose[3:])).tolist()[3:]
        else:
            pose += self._pose[3:]
        try:
            setpoint = setpoint_at(self._kinematics, pose, self._tcp, last, seconds)
            if self._stops:
                self._limits.check(last, setpoint, seconds)
        except (Unreachable, LimitViolation) as error:
            if not self._stops:
                raise LimitViolation(str(error)) from None
            self._brake = JointSpeed(_REST, self._limits.acceleration, None)
            return self._braking(self._brake, last, seconds)
        self._pose, self._speed = pose, speed
        if self._left is None:
            self.move.is_over = line_reached and turn_reached and not self._stops
        else:
            self._left, self.overrun = _passed(self._left, scaling * seconds, seconds)
            self.move.is_over = self._left <= 0.0 and scaling > 0.0
        return setpoint

    def restart(self, begin: Setpoint) -> None:
        """Continue from rest elsewhere."""
        self._pose = self._kinematics.forward(begin.q, self._tcp).tolist()
        self._speed = list(_REST)

    def _braking(self, brake: JointSpeed, last: Setpoint, seconds: float) -> Setpoint:
        setpoint = brake.advance(last, seconds, 1.0, 0.0)
        self.move.is_over, self.is_at_rest = brake.move.is_over, brake.is_at_rest
        return setpoint


def _passed(left: float, passed: float, seconds: float) -> tuple[float, float]:
    """What is left of a time after some has passed, and by how much the cycle in which it ended exceeded it."""
    rest = left - passed
    if rest > 0.01 * seconds:
        return rest, 0.0
    return min(rest, 0.0), max(-rest, 0.0) if left > 0.0 else 0.0


def _towards(now: list[float], target: list[float], most: float) -> tuple[list[float], bool]:
    """A vector closer to a target by at most `most`, and whether it has reached the target."""
    way = [b - a for a, b in zip(now, target, strict=True)]
    distance = math.hypot(*way)
    if distance <= most:
        return target, True
    return [a + most / distance * part for a, part in zip(now, way, strict=True)], False

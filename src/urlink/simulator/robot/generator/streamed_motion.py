"""Motions without a path: set-points of the joints (servoj), and speeds (speedj, speedl; stopj and stopl).

How a controller follows set-points is not published beyond the purpose of the arguments: the look-ahead time smooths,
the gain sharpens. The model here is a guess that keeps to that: each joint follows like a critically damped spring,
which lags behind a set-point of constant speed by half the look-ahead time and two over the gain, in seconds: 22 ms for
0.03 and 300. It never overshoots a set-point that stands still. Firmware without the two arguments lags by the time of
the set-point.

A set-point that holds for several cycles is approached on a straight line over them. If none follows, the arm
comes to rest on the last one.

The scaling stretches the time of a set-point: at 50 %, one of 2 ms lasts 4 ms, and at 0 it does not end. Whether it
stretches the lag too is a parameter (`ScalingParameters.servoj_lag_stretches`).

A stop is a speed of zero. The speed slider stretches the time of a speed: at a slider of 25 % it lasts four times as
long, at a quarter of the speed, and at 0 it does not end (the vendor's client library tests that a spline of such
commands ends on its path).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache
from itertools import repeat
from operator import le, mul, sub

from urlink.arm.parameters import number
from urlink.arm.vectors import JOINTS

from ..setpoint_sources import REST, Setpoint
from .joint_limits import ArmWithTool, JointLimits, LimitViolation, moved
from .path_motion import Command

_OF_LOOKAHEAD = number("servoj_lag_of_lookahead")
# rad and rad/s below which a joint has arrived
_NEAR, _SLOW = 1e-9, 1e-7


def lag_of(t: float, lookahead_time: float, gain: float) -> float:
    """Seconds by which the arm lags behind a set-point of constant speed."""
    if lookahead_time > 0.0 and gain > 0.0:
        return _OF_LOOKAHEAD * lookahead_time + 2.0 / gain
    return t


class ServoMotion(Command):
    """The motion to one set-point.

    Attributes:
        is_over: after one cycle of scaled time, or after `t` s of it if that is longer.
        goal: present point of the line to the set-point, rad.
        overrun: s of scaled time by which the last cycle exceeded the time of the set-point; the next one, if it
            follows in the next cycle, begins with them.
        speeds: six, rad per s of the time in which the lag lasts: scaled time, if it stretches.
        excess: six, rad/s, on top of that: of a motion that was taken over while the scaling was close to 0.
    """

    def __init__(
        self,
        limits: JointLimits,
        begin: list[float],
        end: Sequence[float],
        t: float,
        lag: float,
        *,
        begun: float,
        speeds: Sequence[float],
        excess: Sequence[float],
        stretches: bool,
    ) -> None:
        """A set-point of which `begun` s are over; `stretches`: whether the scaling stretches the lag."""
        self._limits, self._begin, self._end, self._duration, self._lag = limits, begin, list(end), t, lag
        self._time, self._stretches = begun, stretches
        self.goal = begin
        self.speeds, self.excess = list(speeds), list(excess)
        self._is_new = True

    def advance(self, last: Setpoint, seconds: float, scaling: float, change: float) -> Setpoint:
        """The set-point one cycle later.

        Raises:
            LimitViolation: the target is too far for the largest speed of a joint, or out of its range.
        """
        lag, duration = max(self._lag, seconds), max(self._duration, seconds)
        if self._is_new:
            self._check(last.q, lag + duration)
            self._is_new = False
        passed = (scaling - 0.5 * change) * seconds
        self.overrun = 0.0
        if self.is_at_rest:
            self._pass(passed, duration, seconds)
            return Setpoint(self._end, REST, REST)
        old_goals = self.goal
        self._pass(passed, duration, seconds)
        if self.is_over:
            self.goal = self._end
        else:
            part = self._time / duration
            self.goal = [a + part * (b - a) for a, b in zip(self._begin, self._end, strict=True)]
        # The time in which the joints follow, and how much of a speed in it is one in the time of the controller.
        time, share = (passed, scaling) if self._stretches else (seconds, 1.0)
        if time <= 0.0 and not any(self.excess):
            return Setpoint(last.q, REST, [-v / seconds for v in last.qd])
        omega, decay = _follower(lag, time)
        slowed = self._slowed(seconds)
        q: list[float] = []
        qd: list[float] = []
        speeds: list[float] = []
        is_near = self.goal is self._end and not any(slowed)
        for position, speed, old_goal, goal, extra in zip(
            last.q, self.speeds, old_goals, self.goal, slowed, strict=True
        ):
            # Relative to what lags behind the moving goal, a deviation dies away.
            goal_speed = (goal - old_goal) / time if time > 0.0 else 0.0
            trail = lag * goal_speed
            error = position - old_goal + trail
            push = speed - goal_speed + omega * error
            new_error = (error + push * time) * decay - trail
            new_speed = (speed - goal_speed - omega * push * time) * decay + goal_speed
            is_near = is_near and abs(new_error) < _NEAR and abs(new_speed) < _SLOW
            q.append((goal + new_error if time > 0.0 else position) + extra * seconds)
            speeds.append(new_speed if time > 0.0 else speed)
            qd.append(share * speeds[-1] + extra)
        self.speeds, self.excess = speeds, slowed
        if is_near:
            self.is_at_rest = True
            self.speeds = list(REST)
            return Setpoint(self._end, REST, REST)
        return Setpoint(q, qd, [(new - old) / seconds for new, old in zip(qd, last.qd, strict=True)])

    def _pass(self, passed: float, duration: float, seconds: float) -> None:
        """Let scaled time pass; the set-point is over when its own has."""
        self._time += passed
        if not self.is_over and self._time > duration - 0.01 * seconds:
            self.is_over = True
            self.overrun = max(self._time - duration, 0.0)

    def _slowed(self, seconds: float) -> list[float]:
        """The `excess` one cycle later: all joints slow down in proportion."""
        if not any(self.excess):
            return self.excess
        fastest = max(abs(v) / a for v, a in zip(self.excess, self._limits.acceleration, strict=True))
        left = max(0.0, 1.0 - seconds / fastest)
        return [left * v for v in self.excess]

    def _check(self, q: Sequence[float], horizon: float) -> None:
        """Raise if a joint at its largest speed could not reach its target in this time."""
        self._limits.check_target(self._end)
        allowed = self._limits.allowed_speed
        if all(map(le, map(abs, map(sub, self._end, q)), map(mul, allowed, repeat(horizon)))):
            return
        for joint, now, end, most in zip(JOINTS, q, self._end, allowed, strict=True):
            if abs(end - now) > most * horizon:
                raise LimitViolation(f"{joint}: a jump of {end - now:.4f} rad to a servoj target")


@lru_cache(maxsize=256)
def _follower(lag: float, seconds: float) -> tuple[float, float]:
    """The rate of the spring in 1/s, and the part of a deviation that is left after a cycle."""
    omega = 2.0 / lag
    return omega, math.exp(-omega * seconds)


class JointSpeed(Command):
    """All joints change their speeds in proportion until each has its own, and keep it.

    Attributes:
        is_over: after `t` s of scaled time; if `t` is None, when the speed is reached.
    """

    def __init__(self, qd: Sequence[float], acceleration: Sequence[float], t: float | None) -> None:
        """Six speeds, rad/s, and the largest acceleration of each joint, rad/s²."""
        self._target, self._acceleration = list(qd), acceleration
        self._left = t
        self._stops = not any(qd)

    def advance(self, last: Setpoint, seconds: float, scaling: float, change: float) -> Setpoint:
        """The set-point one cycle later."""
        wanted = [scaling * v - old for v, old in zip(self._target, last.qd, strict=True)]
        part = 1.0
        for way, most in zip(wanted, self._acceleration, strict=True):
            if abs(way) > most * seconds * (1.0 + 1e-9):
                part = min(part, most * seconds / abs(way))
        is_reached = part == 1.0
        if is_reached:
            qd = [scaling * v for v in self._target] if not self._stops else REST
        else:
            qd = [old + part * way for old, way in zip(last.qd, wanted, strict=True)]
        q = [a + 0.5 * seconds * (old + new) for a, old, new in zip(last.q, last.qd, qd, strict=True)]
        setpoint = Setpoint(q, qd, [(new - old) / seconds for new, old in zip(qd, last.qd, strict=True)])
        self.is_at_rest = self._stops and is_reached
        if self._left is None:
            self.is_over = is_reached
        else:
            self._left, self.overrun = _passed(self._left, scaling * seconds, seconds)
            self.is_over = self._left <= 0.0 and scaling > 0.0
        return setpoint


class ToolSpeed(Command):
    """The tool changes its speed straight to another one, and keeps that.

    If it has to stop and the arm cannot continue along its line, because that ends or is singular there, the joints
    brake instead.

    Attributes:
        is_over: after `t` s of scaled time; if `t` is None, when the speed is reached; for a stop, at rest.
    """

    def __init__(
        self,
        arm: ArmWithTool,
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
        self._arm = arm
        self._target, self._a, self._a_rot, self._left = list(xd), a, a_rot, t
        self._pose = arm.pose(begin.q)
        self._speed: list[float] = list(REST)
        if old is not None and old._brake is None and old._arm.tcp == arm.tcp:
            self._speed = old._speed
        elif any(begin.qd):
            self._speed = arm.velocity(begin.q, begin.qd).tolist()
        self._stops = not any(xd)
        self._brake: JointSpeed | None = None

    def advance(self, last: Setpoint, seconds: float, scaling: float, change: float) -> Setpoint:
        """The set-point one cycle later.

        Raises:
            LimitViolation: the pose is out of reach.
        """
        if self._brake is not None:
            return self._braking(self._brake, last, seconds)
        if self._stops and not any(self._speed):
            self.is_at_rest = self.is_over = True
            return Setpoint(last.q, REST, REST)
        target = [scaling * v for v in self._target]
        line, line_reached = _towards(self._speed[:3], target[:3], self._a * seconds)
        turn, turn_reached = _towards(self._speed[3:], target[3:], self._a_rot * seconds)
        speed = line + turn
        step = [0.5 * seconds * (old + new) for old, new in zip(self._speed, speed, strict=True)]
        pose = moved(self._pose, step)
        try:
            setpoint = self._arm.setpoint(pose, last, seconds)
            if self._stops:
                self._arm.limits.check(last, setpoint, seconds)
        except LimitViolation:
            if not self._stops:
                raise
            self._brake = JointSpeed(REST, self._arm.limits.acceleration, None)
            return self._braking(self._brake, last, seconds)
        self._pose, self._speed = pose, speed
        if self._left is None:
            self.is_over = line_reached and turn_reached and not self._stops
        else:
            self._left, self.overrun = _passed(self._left, scaling * seconds, seconds)
            self.is_over = self._left <= 0.0 and scaling > 0.0
        return setpoint

    def restart(self, begin: Setpoint) -> None:
        """Continue from rest elsewhere."""
        self._pose = self._arm.pose(begin.q)
        self._speed = list(REST)

    def _braking(self, brake: JointSpeed, last: Setpoint, seconds: float) -> Setpoint:
        setpoint = brake.advance(last, seconds, 1.0, 0.0)
        self.is_over, self.is_at_rest = brake.is_over, brake.is_at_rest
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

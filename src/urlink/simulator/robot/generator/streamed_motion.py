"""Motion commands without a path: commands for set-points of the joints, and commands for speeds.

The command for set-points is servoj. The commands for speeds are speedj, speedl, stopj and stopl; a stop is a speed of
zero. The algorithm with which a real controller follows set-points is not published, only the purpose of two arguments:
a longer look-ahead time makes the motion smoother, and a higher gain makes it follow more closely. The model in this
module is assumed. Each joint follows the set-points like a critically damped spring. If the set-points move at constant
speed, the joint lags behind them by 0.9 of the look-ahead time plus two divided by the gain, in seconds. For a
look-ahead time of 0.03 s and a gain of 300, the lag is 34 ms. A joint never overshoots a set-point that is at rest. On
firmware without the two arguments, the lag is the time of the set-point.

If the time of a set-point is several cycles long, the goal of the joints moves on a straight line to the set-point
during these cycles. If no other set-point follows, the arm comes to rest at the last set-point.

The speed scaling stretches the time of a set-point. At 50 %, a set-point of 2 ms lasts 4 ms; at 0 %, it does not end.
The parameter `ScalingParameters.servoj_lag_stretches` determines whether the scaling also stretches the lag.

The speed scaling also stretches the time of a speed command. At 25 %, the command lasts four times as long, with a
quarter of the speed; at 0 %, it does not end. A test of the vendor's client library requires that a spline of speed
commands ends on its path.
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
from .joint_limits import SUDDEN, ArmWithTool, JointLimits, LimitViolation, moved
from .path_motion import Command

_OF_LOOKAHEAD = number("servoj_lag_of_lookahead")
# Tolerances in rad and rad/s within which a joint has arrived at a set-point.
_NEAR, _SLOW = 1e-9, 1e-7


def lag_of(t: float, lookahead_time: float, gain: float) -> float:
    """Return the lag of the arm behind set-points that move at constant speed, in s."""
    if lookahead_time > 0.0 and gain > 0.0:
        return _OF_LOOKAHEAD * lookahead_time + 2.0 / gain
    return t


class ServoMotion(Command):
    """Motion to one set-point of servoj.

    Attributes:
        is_over: Whether the time of the set-point has passed: `t` seconds of scaled time, but at least one cycle.
        goal: Current point on the line to the set-point, in rad.
        overrun: Scaled time, in s, by which the last cycle exceeded the time of the set-point. If the next set-point
            follows in the next cycle, its elapsed time begins with this value.
        speeds: Six joint speeds, in rad/s. If the lag stretches, they are speeds in scaled time.
        excess: Six additional joint speeds, in rad/s, which decay. They are not zero if a motion was taken over while
            the scaling was close to 0.
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
        """Begin a set-point.

        Args:
            limits: Limits of the joints.
            begin: Joint positions at the beginning of the line to the set-point, in rad.
            end: Joint positions of the set-point, in rad.
            t: Time of the set-point, in s.
            lag: Lag, in s.
            begun: Elapsed time of the set-point at its beginning, in s.
            speeds: See `speeds` above.
            excess: See `excess` above.
            stretches: Whether the scaling stretches the lag.
        """
        self._limits, self._begin, self._end, self._duration, self._lag = limits, begin, list(end), t, lag
        self._time, self._stretches = begun, stretches
        self.goal = begin
        self.speeds, self.excess = list(speeds), list(excess)
        self._is_new = True

    def advance(self, last: Setpoint, seconds: float, scaling: float, change: float) -> Setpoint:
        """Return the set-point one cycle later.

        Raises:
            LimitViolation: If a joint cannot reach its target in time at its maximum speed, or if the target is out of
                range.
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
        # Time by which the spring model advances, and factor that converts a speed of this model to a real speed.
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
            # The spring model: the difference between the joint and the point that lags behind the moving goal decays
            # exponentially.
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
        """Advance by scaled time; the set-point ends when its time has passed."""
        self._time += passed
        if not self.is_over and self._time > duration - 0.01 * seconds:
            self.is_over = True
            self.overrun = max(self._time - duration, 0.0)

    def _slowed(self, seconds: float) -> list[float]:
        """Return `excess` one cycle later; all joints slow down in proportion."""
        if not any(self.excess):
            return self.excess
        fastest = max(abs(v) / a for v, a in zip(self.excess, self._limits.acceleration, strict=True))
        left = max(0.0, 1.0 - seconds / fastest)
        return [left * v for v in self.excess]

    def _check(self, q: Sequence[float], horizon: float) -> None:
        """Raise if a joint cannot reach its target at its maximum speed in `horizon` seconds."""
        self._limits.check_target(self._end)
        allowed = self._limits.allowed_speed
        if all(map(le, map(abs, map(sub, self._end, q)), map(mul, allowed, repeat(horizon)))):
            return
        for joint, now, end, most in zip(JOINTS, q, self._end, allowed, strict=True):
            if abs(end - now) > most * horizon:
                text = f"{joint}: the servoj target is {end - now:.4f} rad away; it is out of reach"
                raise LimitViolation(text, SUDDEN)


@lru_cache(maxsize=256)
def _follower(lag: float, seconds: float) -> tuple[float, float]:
    """Return the rate of the spring in 1/s, and the fraction of a deviation that remains after `seconds`."""
    omega = 2.0 / lag
    return omega, math.exp(-omega * seconds)


class JointSpeed(Command):
    """Motion to target speeds of the joints.

    All joints change their speeds in proportion, and then keep the target speeds.

    Attributes:
        is_over: Whether `t` seconds of scaled time have passed. If `t` is None, whether the target speeds are reached.
    """

    def __init__(self, qd: Sequence[float], acceleration: Sequence[float], t: float | None) -> None:
        """Begin a change of the joint speeds.

        Args:
            qd: Six speeds, in rad/s.
            acceleration: Maximum acceleration of each joint, in rad/s².
            t: Scaled time until the command ends, in s. If None, it ends when the target speed is reached.
        """
        self._target, self._acceleration = list(qd), acceleration
        self._left = t
        self._stops = not any(qd)

    def advance(self, last: Setpoint, seconds: float, scaling: float, change: float) -> Setpoint:
        """Return the set-point one cycle later."""
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
    """Motion to a target speed of the tool.

    The tool changes its speed at a constant rate, and then keeps the target speed.

    If the tool has to stop, but the arm cannot continue on the line of the tool, the joints brake instead.

    Attributes:
        is_over: Whether `t` seconds of scaled time have passed. If `t` is None, whether the target speed is reached;
            for a stop, whether the arm is at rest.
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
        """Begin a change of the tool speed.

        If `old` is a tool speed with the same TCP, its exact speed is continued, so that the line has no kink.

        Args:
            arm: Arm with its tool.
            begin: Current set-point.
            xd: Speed of the TCP in the base frame, in m/s and rad/s.
            a: Acceleration, in m/s².
            a_rot: Angular acceleration, in rad/s².
            t: Scaled time until the command ends, in s. If None, it ends when the target speed is reached.
            old: Previous command if it is a tool speed, or None.
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
        """Return the set-point one cycle later.

        Raises:
            LimitViolation: If the pose is out of reach.
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
        """Continue from another position, at which the arm has stopped."""
        self._pose = self._arm.pose(begin.q)
        self._speed = list(REST)

    def _braking(self, brake: JointSpeed, last: Setpoint, seconds: float) -> Setpoint:
        setpoint = brake.advance(last, seconds, 1.0, 0.0)
        self.is_over, self.is_at_rest = brake.is_over, brake.is_at_rest
        return setpoint


def _passed(left: float, passed: float, seconds: float) -> tuple[float, float]:
    """Return the remaining time, and the time by which this cycle exceeded it."""
    rest = left - passed
    if rest > 0.01 * seconds:
        return rest, 0.0
    return min(rest, 0.0), max(-rest, 0.0) if left > 0.0 else 0.0


def _towards(now: list[float], target: list[float], most: float) -> tuple[list[float], bool]:
    """Return `now`, changed towards the target by at most `most`, and whether the target is reached."""
    way = [b - a for a, b in zip(now, target, strict=True)]
    distance = math.hypot(*way)
    if distance <= most:
        return target, True
    return [a + most / distance * part for a, part in zip(now, way, strict=True)], False

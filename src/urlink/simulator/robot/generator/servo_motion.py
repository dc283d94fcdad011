"""Following a stream of set-points of the joints: servoj.

How a controller follows them is not published beyond the purpose of the arguments: the look-ahead time smooths, the
gain sharpens. The model here is a guess that keeps to that: each joint follows like a critically damped spring, which
lags behind a set-point of constant speed by half the look-ahead time and two over the gain, in seconds: 22 ms for 0.03
and 300. It never overshoots a set-point that stands still. Firmware without the two arguments lags by the time of the
set-point.

A set-point that holds for several cycles is approached on a straight line over them. If none follows, the arm
comes to rest on the last one.

The scaling stretches the time of a set-point: at 50 %, one of 2 ms lasts 4 ms, and at 0 it does not end. Whether it
stretches the lag too is a parameter (`ScalingParameters.servoj_lag_stretches`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache
from itertools import repeat
from operator import le, mul, sub

from ..sources import Setpoint
from .joint_limits import JOINTS, JointLimits, LimitViolation
from .path_motion import Move

__all__ = ["ServoMotion", "lag_of"]

_REST = [0.0] * 6
# rad and rad/s below which a joint has arrived
_NEAR, _SLOW = 1e-9, 1e-7


def lag_of(t: float, lookahead_time: float, gain: float) -> float:
    """Seconds by which the arm lags behind a set-point of constant speed."""
    if lookahead_time > 0.0 and gain > 0.0:
        return 0.5 * lookahead_time + 2.0 / gain
    return t


class ServoMotion:
    """The motion to one set-point.

    Attributes:
        move: over after one cycle of scaled time, or after `t` s of it if that is longer.
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
        begun: float = 0.0,
        speeds: Sequence[float] = _REST,
        excess: Sequence[float] = _REST,
        stretches: bool = True,
    ) -> None:
        """A set-point of which `begun` s are over; `stretches`: whether the scaling stretches the lag."""
        self.move = Move()
        self._limits, self._begin, self._end, self._duration, self._lag = limits, begin, list(end), t, lag
        self._time, self._stretches = begun, stretches
        self.goal = begin
        self.overrun = 0.0
        self.speeds, self.excess = list(speeds), list(excess)
        self._is_new = True
        self.is_at_rest = False

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
            return Setpoint(self._end, _REST, _REST)
        old_goals = self.goal
        self._pass(passed, duration, seconds)
        if self.move.is_over:
            self.goal = self._end
        else:
            part = self._time / duration
            self.goal = [a + part * (b - a) for a, b in zip(self._begin, self._end, strict=True)]
        # The time in which the joints follow, and how much of a speed in it is one in the time of the controller.
        time, share = (passed, scaling) if self._stretches else (seconds, 1.0)
        if time <= 0.0 and not any(self.excess):
            return Setpoint(last.q, _REST, [-v / seconds for v in last.qd])
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
            self.speeds = list(_REST)
            return Setpoint(self._end, _REST, _REST)
        return Setpoint(q, qd, [(new - old) / seconds for new, old in zip(qd, last.qd, strict=True)])

    def _pass(self, passed: float, duration: float, seconds: float) -> None:
        """Let scaled time pass; the set-point is over when its own has."""
        self._time += passed
        if not self.move.is_over and self._time > duration - 0.01 * seconds:
            self.move.is_over = True
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

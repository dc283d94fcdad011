"""Following a stream of set-points of the joints: servoj.

How a controller follows them is not published beyond the purpose of the arguments: the look-ahead time smooths, the
gain sharpens. The model here is a guess that keeps to that: each joint follows like a critically damped spring, which
lags behind a set-point of constant speed by half the look-ahead time and two over the gain, in seconds: 22 ms for 0.03
and 300. It never overshoots a set-point that stands still. Firmware without the two arguments lags by the time of the
set-point.

A set-point that holds for several cycles is approached on a straight line over them. If none follows, the arm
comes to rest on the last one. The speed slider does not scale it here, as it does on a controller
(docs/protocols/urscript.md, Speed scaling).
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
        move: over after one cycle, or after `t` s if that is longer.
        goal: present point of the line to the set-point, rad.
    """

    def __init__(self, limits: JointLimits, begin: list[float], end: Sequence[float], t: float, lag: float) -> None:
        self.move = Move()
        self._limits, self._begin, self._end, self._duration, self._lag = limits, begin, list(end), t, lag
        self._time = 0.0
        self.goal = begin
        self._is_new = True
        self.is_at_rest = False

    def advance(self, last: Setpoint, seconds: float, scaling: float, change: float) -> Setpoint:
        """The set-point one cycle later.

        Raises:
            LimitViolation: the target is too far for the largest speed of a joint, or out of its range.
        """
        lag = max(self._lag, seconds)
        if self._is_new:
            self._check(last.q, lag + max(self._duration, seconds))
            self._is_new = False
        if self.is_at_rest:
            return Setpoint(self._end, _REST, _REST)
        self._time += seconds
        old_goals = self.goal
        if self._time + 0.5 * seconds >= self._duration:
            self.goal = self._end
            self.move.is_over = True
        else:
            part = self._time / self._duration
            self.goal = [a + part * (b - a) for a, b in zip(self._begin, self._end, strict=True)]
        omega, decay = _follower(lag, seconds)
        q: list[float] = []
        qd: list[float] = []
        qdd: list[float] = []
        is_near = self.goal is self._end
        for position, speed, old_goal, goal in zip(last.q, last.qd, old_goals, self.goal, strict=True):
            # Relative to what lags behind the moving goal, a deviation dies away.
            goal_speed = (goal - old_goal) / seconds
            trail = lag * goal_speed
            error = position - old_goal + trail
            push = speed - goal_speed + omega * error
            new_error = (error + push * seconds) * decay - trail
            new_speed = (speed - goal_speed - omega * push * seconds) * decay + goal_speed
            is_near = is_near and abs(new_error) < _NEAR and abs(new_speed) < _SLOW
            q.append(goal + new_error)
            qd.append(new_speed)
            qdd.append((new_speed - speed) / seconds)
        if is_near:
            self.is_at_rest = True
            return Setpoint(self._end, _REST, _REST)
        return Setpoint(q, qd, qdd)

    def _check(self, q: Sequence[float], horizon: float) -> None:
        """Raise if a joint at its largest speed could not reach its target in this time."""
        self._limits.check_target(self._end)
        allowed = self._limits.allowed_speed
        if all(map(le, map(abs, map(sub, self._end, q)), map(mul, allowed, repeat(horizon)))):
            return
        for joint, now, end, most in zip(JOINTS, q, self._end, allowed, strict=True):
            if abs(end - now) > most * horizon:
                raise LimitViolation(f"{joint}: a jump of {end - now:.4f} rad to a servoj target")


@lru_cache(maxsize=64)
def _follower(lag: float, seconds: float) -> tuple[float, float]:
    """The rate of the spring in 1/s, and the part of a deviation that is left after a cycle."""
    omega = 2.0 / lag
    return omega, math.exp(-omega * seconds)

"""Jerk-limited motion of joints to rest at a target, as fast as the limits of speed, acceleration and jerk allow.

The motion of one joint begins with a position x, a speed v and an acceleration a. If the joint brakes as hard as the
limits allow, it comes to rest at a certain position. If the target is beyond this position, the joint is first pushed
towards the target, and then brakes. A push uses the largest jerk until the largest acceleration is reached, and then
keeps this acceleration. The longer the push, the further away the joint comes to rest. Therefore the duration of the
push is the root of an increasing function. If the push would reach the largest speed, the joint keeps this speed for as
long as needed. The motion has at most seven segments of constant jerk, in which the acceleration rises, is constant,
falls, is zero (cruise), falls, is constant, and rises. If the target is in the other direction, all signs are reversed.

Braking has three segments of constant jerk: the deceleration increases, is constant, and decreases to zero.

Each joint reaches its target in its own time. Faster joints are not slowed down so that all joints arrive together.

All numbers are plain floats, because one numpy operation takes longer than the whole calculation for one joint.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from numpy.typing import ArrayLike

from linkcore.arguments import check_number

from ...arm.models import Model
from ...arm.vectors import JOINTS, six_limits
from ..limited import Prediction

#: Maximum number of steps of `root`. Each step at least halves the bracket, so 60 steps are always enough; six are
#: usual.
_MOST_STEPS = 60


def root(function: Callable[[float], float], low: float, high: float, precision: float) -> float:
    """Return the root of an increasing function, with the method of Ridders.

    The root is always between the two ends of a bracket. In each step, an exponential factor is fitted to the values at
    both ends and in the middle, and gives an estimate of the root. The bracket is then reduced with the estimate and
    the middle. The method converges quadratically, and at least halves the bracket in each step (C. Ridders, "A New
    Algorithm for Computing a Single Root of a Real Continuous Function", IEEE Transactions on Circuits and Systems,
    1979).

    Args:
        function: Increasing function. Except for rounding errors, it must not be positive at `low`, nor negative at
            `high`.
        low, high: Ends of the bracket.
        precision: Largest accepted distance of the function's value from 0.
    """
    at_low, at_high = function(low), function(high)
    for _ in range(_MOST_STEPS):
        if at_low >= -precision:
            return low
        if at_high <= precision:
            return high
        middle = 0.5 * (low + high)
        at_middle = function(middle)
        x = middle - (middle - low) * at_middle / math.sqrt(at_middle * at_middle - at_low * at_high)
        # If the root is below the middle, x is above the middle, and vice versa.
        for place, value in ((middle, at_middle), (x, function(x))):
            if value < 0.0:
                low, at_low = place, value
            else:
                high, at_high = place, value
    return low


#: Largest position error at the target, in rad: a millionth of the resolution of a set-point.
_PRECISION = 1e-12

#: Duration of a segment in s, and its jerk in rad/s³.
_Segment = tuple[float, float]


@dataclass(frozen=True)
class JointLimit:
    """Limits of one joint, in rad/s, rad/s² and rad/s³."""

    speed: float
    acceleration: float
    jerk: float


def joint_limits(
    model: Model | None, speed: ArrayLike, acceleration: ArrayLike, jerk: ArrayLike
) -> tuple[JointLimit, ...]:
    """Return the limits of six joints. Each limit is one number for all joints, or has shape (6,).

    Args:
        model: Model of the arm; None if it is unknown. The limits must not exceed those of the model. The vendor
            publishes no limits of acceleration: see `urlink.models`.
        speed, acceleration, jerk: Limits in rad/s, rad/s² and rad/s³.

    Raises:
        BadValue: If a limit is not positive, or exceeds the limit of the arm.
    """
    rows = [six_limits(speed, "speed"), six_limits(acceleration, "acceleration"), six_limits(jerk, "jerk")]
    if model is not None:
        for name, unit, values, most in (
            ("speed", "rad/s", rows[0], model.max_speed),
            ("acceleration", "rad/s²", rows[1], model.max_acceleration),
        ):
            for joint, (value, limit) in enumerate(zip(values.tolist(), most.tolist(), strict=True)):
                check_number(value, f"{name}[{joint}] ({JOINTS[joint]})", 0.0, limit, unit, f"a {model.name}")
    return tuple(JointLimit(*values) for values in zip(*(row.tolist() for row in rows), strict=True))


class JointProfile:
    """Motion of one joint from an initial state to rest at a target.

    Args:
        x, v, a: Initial position, speed and acceleration in rad, rad/s and rad/s². They must be within the limits. The
            speed must also stay within the limits while the acceleration decreases to 0 as fast as the jerk allows.
        target: Target in rad.
        limit: Limits of the joint.

    Attributes:
        duration: Duration in s.
    """

    __slots__ = ("_pieces", "_target", "duration")

    def __init__(self, x: float, v: float, a: float, target: float, limit: JointLimit) -> None:
        self._target = target
        #: (end, begin, x, v, a, jerk) of each segment
        self._pieces: list[tuple[float, float, float, float, float, float]] = []
        t = 0.0
        for seconds, jerk in _segments(x, v, a, target, limit):
            self._pieces.append((t + seconds, t, x, v, a, jerk))
            x, v, a = _after(x, v, a, jerk, seconds)
            t += seconds
        self.duration = t

    def at(self, t: float) -> tuple[float, float, float]:
        """Return position, speed and acceleration at `t` seconds after the beginning.

        After the end, return the target at rest.
        """
        for end, begin, x, v, a, jerk in self._pieces:
            if t < end:
                return _after(x, v, a, jerk, t - begin)
        return self._target, 0.0, 0.0


class TargetFilter:
    """Filter for six joints that move to targets. The targets may change at any time.

    After each new target, the motion is planned again from the current positions, speeds and accelerations of the
    joints. So no limit is ever exceeded, even if targets jump or arrive irregularly.

    Args:
        q: Initial positions of the arm at rest, shape (6,), in rad.
        limits: Limits of each joint.

    Attributes:
        q, qd, qdd: Current positions, speeds and accelerations, shape (6,), in rad, rad/s and rad/s².
        target: Target, shape (6,), in rad.
    """

    def __init__(self, q: Sequence[float], limits: Sequence[JointLimit]) -> None:
        self._limits = tuple(limits)
        self.q, self.qd, self.qdd = list(q), [0.0] * 6, [0.0] * 6
        self.target = list(q)
        self._profiles = [JointProfile(x, 0.0, 0.0, x, limit) for x, limit in zip(q, self._limits, strict=True)]
        #: time in s since the profile of each joint began
        self._times = [0.0] * 6

    def aim(self, target: Sequence[float]) -> None:
        """Plan the motion to another target, (6,) rad, from the current state."""
        for joint, (old, new) in enumerate(zip(self.target, target, strict=True)):
            if old != new:
                self._plan(joint, new)
        self.target = list(target)

    def restart(self, q: Sequence[float], qd: Sequence[float]) -> None:
        """Continue to the target from other positions, (6,) rad, at other speeds, (6,) rad/s.

        The accelerations do not change, except if a joint would then exceed its largest speed.
        """
        self.q = list(q)
        for joint, (speed, limit) in enumerate(zip(qd, self._limits, strict=True)):
            self.qd[joint] = v = max(-limit.speed, min(speed, limit.speed))
            # While the acceleration decreases to 0, the speed must not exceed its limit.
            up, down = (math.sqrt(2.0 * limit.jerk * (limit.speed - each)) for each in (v, -v))
            self.qdd[joint] = max(-down, min(self.qdd[joint], up))
        for joint, x in enumerate(self.target):
            self._plan(joint, x)

    def _plan(self, joint: int, target: float) -> None:
        state = self.q[joint], self.qd[joint], self.qdd[joint]
        self._profiles[joint] = JointProfile(*state, target, self._limits[joint])
        self._times[joint] = 0.0

    def predicted(self, target: Sequence[float], delay: float) -> Prediction:
        """Return the predicted motion to a target that is used after `delay` seconds; the filter does not change."""
        other = copy.copy(self)
        other._profiles, other._times = list(self._profiles), list(self._times)
        other.q, other.qd, other.qdd = list(self.q), list(self.qd), list(self.qdd)
        other.advance(delay)
        other.aim(target)
        left = max(profile.duration - t for profile, t in zip(other._profiles, other._times, strict=True))
        return other.after, max(left, 0.0)

    def after(self, seconds: float) -> tuple[list[float], list[float]]:
        """Return the positions, (6,) rad, and the speeds, (6,) rad/s, at `seconds` after the current time."""
        states = [profile.at(t + seconds) for profile, t in zip(self._profiles, self._times, strict=True)]
        return [x for x, _, _ in states], [v for _, v, _ in states]

    def advance(self, seconds: float) -> None:
        """Advance the current time by `seconds`, and update the state of the joints."""
        for joint, profile in enumerate(self._profiles):
            self._times[joint] = t = self._times[joint] + seconds
            self.q[joint], self.qd[joint], self.qdd[joint] = profile.at(t)


def _after(x: float, v: float, a: float, jerk: float, t: float) -> tuple[float, float, float]:
    """Return the state of a joint after `t` seconds of constant jerk."""
    return x + t * (v + t * (0.5 * a + t * jerk / 6.0)), v + t * (a + 0.5 * t * jerk), a + t * jerk


def _brake(v: float, a: float, limit: JointLimit) -> tuple[_Segment, _Segment, _Segment]:
    """Return the segments of the fastest motion to rest. The position of rest is not given."""
    most, jerk = limit.acceleration, limit.jerk
    # The direction of braking follows from the speed that would remain after the acceleration has decreased to 0.
    if v + 0.5 * a * abs(a) / jerk > 0.0:
        jerk, a, gain = -jerk, -a, v
    else:
        gain = -v
    each = limit.jerk
    peak = math.sqrt(max(each * gain + 0.5 * a * a, 0.0))
    held = 0.0
    if peak > most:
        peak = most
        held = max(gain - (most * most - 0.5 * a * a) / each, 0.0) / most
    return (max(peak - a, 0.0) / each, jerk), (held, 0.0), (peak / each, -jerk)


def _way(v: float, a: float, segments: Sequence[_Segment]) -> float:
    """Return the distance that a joint covers in these segments, in rad."""
    x = 0.0
    for t, jerk in segments:
        x, v, a = _after(x, v, a, jerk, t)
    return x


def _segments(x: float, v: float, a: float, target: float, limit: JointLimit) -> list[_Segment]:
    way = target - x
    braking = _brake(v, a, limit)
    rest = way - _way(v, a, braking)
    if rest >= 0.0:
        return _pushed(way, v, a, braking, limit)
    mirrored = tuple((t, -jerk) for t, jerk in braking)
    return [(t, -jerk) for t, jerk in _pushed(-way, -v, -a, mirrored, limit)]


def _pushed(way: float, v: float, a: float, braking: Sequence[_Segment], limit: JointLimit) -> list[_Segment]:
    """Return the segments of a push and of the braking after it.

    The distance `way` must be at least the braking distance without a push.
    """
    most, jerk = limit.acceleration, limit.jerk
    until_held = max(most - a, 0.0) / jerk
    held_x, held_v, _ = _after(0.0, v, a, jerk, until_held)
    fading = most**3 / (6.0 * jerk * jerk)

    def pushed(seconds: float) -> tuple[float, float, float]:
        if seconds <= until_held:
            return _after(0.0, v, a, jerk, seconds)
        held = seconds - until_held
        return held_x + held * (held_v + 0.5 * held * most), held_v + held * most, most

    def missing(seconds: float) -> float:
        # The formula of `_way` for the segments of `_brake`, written out, because most of the time is spent here.
        x, speed, acceleration = pushed(seconds)
        square = max(jerk * speed + 0.5 * acceleration * acceleration, 0.0)
        if square <= most * most:
            peak = math.sqrt(square)
            t = (peak + acceleration) / jerk
            x += square * peak / (6.0 * jerk * jerk)
        else:
            t = (most + acceleration) / jerk
            held = (square / jerk - most * most / jerk) / most
            x += held * (0.5 * most * most / jerk + 0.5 * most * held) + fading
        return x + t * (speed + t * (0.5 * acceleration - t * jerk / 6.0)) - way

    # Braking may begin with a segment in the direction of the push. The push is at least as long as this segment.
    (first, its_jerk), (held, _), _ = braking
    least = first + held if its_jerk > 0.0 else 0.0
    # After the longest push, the acceleration reaches 0 exactly when the joint reaches its largest speed.
    slack = max(limit.speed - v + 0.5 * a * a / jerk, 0.0)
    if jerk * slack <= most * most:
        peak = math.sqrt(jerk * slack)
        longest = (peak - a) / jerk
    else:
        peak = most
        longest = until_held + (slack - most * most / jerk) / most
    longest = max(longest, least)
    too_short = -missing(longest)
    if too_short > 0.0:
        end = [(peak / jerk, -jerk), (too_short / limit.speed, 0.0), *_brake(limit.speed, 0.0, limit)]
        seconds = longest
    else:
        seconds = root(missing, least, longest, _PRECISION)
        _, speed, acceleration = pushed(seconds)
        end = list(_brake(speed, acceleration, limit))
    return [(min(seconds, until_held), jerk), (max(seconds - until_held, 0.0), 0.0), *end]

"""Jerk-limited motion of a joint from any state to rest, as fast as limits of speed, acceleration and jerk allow.

For one joint, with position x, speed v and acceleration a: if it brakes as hard as the limits allow, it comes to rest
at some position. If the target is beyond this position, the joint is first pushed towards the target. A push uses the
largest jerk until the largest acceleration is reached. Then the joint brakes. The longer the push, the further away the
joint comes to rest, so the length of the push is the root of a growing function. If the push would reach the largest
speed, the joint keeps this speed for as long as needed. This makes at most seven segments of constant jerk: up, hold,
down, cruise, down, hold, up. If the target is in the other direction, everything is mirrored.

Braking works in the same way, with the speed in place of the position: the acceleration grows, is held, and decreases.

Each joint reaches its target in its own time. Joints are not slowed down to arrive together.

All numbers are plain floats, because one operation of numpy takes longer than all of this for one joint.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from numpy.typing import ArrayLike

from linkcore.arguments import check_number

from ...arm.models import Model
from ...arm.vectors import JOINTS, six_limits

#: Maximum number of steps. Each at least halves the bracket, so nothing is left of it. Six are usual.
_MOST_STEPS = 60


def root(function: Callable[[float], float], low: float, high: float, precision: float) -> float:
    """Return the root of a growing function, by the method of Ridders.

    In a bracket, an exponential function is fitted to both ends and the middle. Its root and the middle are the ends of
    the next bracket. It converges quadratically, and halves the bracket at least (C. Ridders, "A New Algorithm for
    Computing a Single Root of a Real Continuous Function", IEEE Transactions on Circuits and Systems, 1979).

    Args:
        function: Function that is not positive at `low` and not negative at `high`, except for rounding.
        low, high: Ends of the bracket.
        precision: Precision of the value of the function.
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


#: Largest error of a push at its target, in rad: a millionth of the resolution of a set-point.
_PRECISION = 1e-12

#: Duration in s, and jerk in rad/s³, of a segment.
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
    """Return the limits of six joints, each given as one number for all joints or as (6,).

    Args:
        model: Model of the arm, whose own limits must not be exceeded; None if the arm is unknown. The vendor publishes
            no limits of acceleration: see `urlink.models`.
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
    """Motion of one joint from a state to rest at a target.

    Args:
        x, v, a: Position, speed and acceleration in rad, rad/s and rad/s², within the limits. The speed must also be
            within the limits after the acceleration has decreased to 0 as fast as the jerk allows.
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
        """Return position, speed and acceleration `t` s after the beginning; after the end, return the target."""
        for end, begin, x, v, a, jerk in self._pieces:
            if t < end:
                return _after(x, v, a, jerk, t - begin)
        return self._target, 0.0, 0.0


class TargetFilter:
    """Six joints that move to targets, which may change at any time.

    Each new target makes a new plan from the current positions, speeds and accelerations of the joints. So no limit is
    exceeded, whatever the targets are and whenever they arrive.

    Args:
        q: Positions at rest, shape (6,), in rad.
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
        #: time in s since each profile began
        self._times = [0.0] * 6

    def aim(self, target: Sequence[float]) -> None:
        """Move to another target, (6,) rad, from now on."""
        for joint, (old, new) in enumerate(zip(self.target, target, strict=True)):
            if old != new:
                self._plan(joint, new)
        self.target = list(target)

    def restart(self, q: Sequence[float], qd: Sequence[float]) -> None:
        """Continue to the target from other positions, (6,) rad, at other speeds, (6,) rad/s.

        The accelerations do not change, unless they would lead to more than the largest speeds.
        """
        self.q = list(q)
        for joint, (speed, limit) in enumerate(zip(qd, self._limits, strict=True)):
            self.qd[joint] = v = max(-limit.speed, min(speed, limit.speed))
            # While it decreases to 0, the acceleration must not exceed the largest speed.
            up, down = (math.sqrt(2.0 * limit.jerk * (limit.speed - each)) for each in (v, -v))
            self.qdd[joint] = max(-down, min(self.qdd[joint], up))
        for joint, x in enumerate(self.target):
            self._plan(joint, x)

    def _plan(self, joint: int, target: float) -> None:
        state = self.q[joint], self.qd[joint], self.qdd[joint]
        self._profiles[joint] = JointProfile(*state, target, self._limits[joint])
        self._times[joint] = 0.0

    def after(self, seconds: float) -> tuple[list[float], list[float]]:
        """Return the positions, (6,) rad, and speeds, (6,) rad/s, `seconds` later."""
        states = [profile.at(t + seconds) for profile, t in zip(self._profiles, self._times, strict=True)]
        return [x for x, _, _ in states], [v for _, v, _ in states]

    def advance(self, seconds: float) -> None:
        """Advance the time."""
        for joint, profile in enumerate(self._profiles):
            self._times[joint] = t = self._times[joint] + seconds
            self.q[joint], self.qd[joint], self.qdd[joint] = profile.at(t)


def _after(x: float, v: float, a: float, jerk: float, t: float) -> tuple[float, float, float]:
    """Return the state after `t` s of constant jerk."""
    return x + t * (v + t * (0.5 * a + t * jerk / 6.0)), v + t * (a + 0.5 * t * jerk), a + t * jerk


def _brake(v: float, a: float, limit: JointLimit) -> tuple[_Segment, _Segment, _Segment]:
    """Return the segments of the fastest motion to rest, at any position."""
    most, jerk = limit.acceleration, limit.jerk
    # The direction follows from the speed that remains when the acceleration decreases to 0 at once.
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
    """Return the distance that the segments cover, in rad."""
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
    """Return a push and the braking after it; `way` is at least the braking distance without a push."""
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
        # `_way` of `_brake`, written out, because most of the time is spent here.
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

    # Braking may itself begin with a push. The whole push is at least as long as this part.
    (first, its_jerk), (held, _), _ = braking
    least = first + held if its_jerk > 0.0 else 0.0
    # At the end of the longest push, the acceleration decreases to 0 just when the largest speed is reached.
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

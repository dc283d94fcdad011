"""Speed limit of set-points: each joint has a time budget, which its motion uses up.

If a joint cannot reach a set-point in time, the controller answers with a protective stop. Therefore every set-point is
checked here, wherever it was computed. Moving a joint by x rad uses x / (its largest speed) seconds of its budget. Each
second that passes adds one second, up to a maximum:

- one period of the set-points plus `EARLY`, as long as they are sent regularly;
- after a late set-point, additionally its lateness (at most `LATE`, unless another bound is given), for the set-points
  that follow it directly. During the delay, the program on the robot continues at its last speed
  (`urlink.script.streaming`), so catching up is not a jump. The first set-point that is on time again drops the rest of
  the lateness.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from numpy.typing import ArrayLike

from linkcore.arguments import check_number

from ...arm.bounds import JOINT_SPEED
from ...arm.models import Model
from ...arm.vectors import JOINTS, FloatArray, six

#: Largest time in s that a set-point may be early. Chosen: more than the jitter of a sleep in Python, but so little
#: that the simulated arm, driven at its largest speed, does not stop because of it.
EARLY = 0.001
#: Lateness in s that may be made up for at once. Chosen: a tenth of the default watchdog.
LATE = 0.01
#: Longest period that counts, in s. In a slower loop, a step may not be larger, because the arm executes it at once.
LONGEST_PERIOD = 0.02

#: Rounding of set-points to millionths, in rad, which must not count as speed.
_SLACK = 2e-6


def largest_speeds(model: Model | None) -> tuple[float, ...]:
    """Return the largest speeds, (6,) in rad/s; for an unknown arm, the speeds of the fastest arm."""
    return (JOINT_SPEED.most,) * 6 if model is None else tuple(model.max_speed.tolist())


def check_joint_speeds(values: ArrayLike, name: str, model: Model | None) -> FloatArray:
    """Return speeds of the joints as (6,) numbers in rad/s, read-only.

    Raises:
        BadValue: If these are not six finite numbers, or are too fast for the arm. An unknown arm counts as the
            fastest.
    """
    speeds = six(values, name)
    for joint, (value, limit) in enumerate(zip(speeds.tolist(), largest_speeds(model), strict=True)):
        whose = "the fastest arm" if model is None else f"a {model.name}"
        check_number(value, f"{name}[{joint}] ({JOINTS[joint]})", -limit, limit, "rad/s", whose)
    return speeds


class SpeedLimit:
    """Time budget of each joint, in s at its full speed.

    Args:
        speeds: Largest speeds of the joints, shape (6,), in rad/s.
        period: Time between two set-points, in s.
        late: Lateness in s that may be made up for at once.

    The argument `now` of its methods is in monotonic seconds.
    """

    def __init__(self, speeds: Sequence[float], period: float, late: float = LATE) -> None:
        self._speeds = speeds
        self._period = min(period, LONGEST_PERIOD)
        self._even = self._period + EARLY
        self._late = late
        self._budget = [self._even] * 6
        self._at = math.inf

    def excess(self, before: Sequence[float], after: Sequence[float], now: float) -> str | None:
        """Return why a move from `before` to `after`, (6,) rad, is too fast now; None if it is not."""
        budgets = self._budgets(now)
        for joint, (here, there, speed, seconds) in enumerate(zip(before, after, self._speeds, budgets, strict=True)):
            most = speed * seconds + _SLACK
            if not abs(there - here) <= most:  # true for NaN too
                return (
                    f"q[{joint}] ({JOINTS[joint]}) is {there:.4f} rad, {abs(there - here):.4f} rad from the last "
                    f"set-point; at most {most:.4f} rad by now, at {speed:.2f} rad/s"
                )
        return None

    def take(self, before: Sequence[float], after: Sequence[float], now: float) -> None:
        """Count a set-point that was sent after `excess` allowed it."""
        self._budget = [
            max(seconds - abs(there - here) / speed, 0.0)
            for here, there, speed, seconds in zip(before, after, self._speeds, self._budgets(now), strict=True)
        ]
        self._at = now

    def _budgets(self, now: float) -> list[float]:
        """Return the time budget of each joint at this time, in s."""
        passed = max(now - self._at, 0.0)
        if passed > 1.5 * self._period:
            ceiling = self._even + min(passed - self._period, self._late)
            return [min(left + passed, ceiling) for left in self._budget]
        if passed > 0.5 * self._period:
            return [min(left + passed, self._even) for left in self._budget]
        return [min(left + passed, max(self._even, left)) for left in self._budget]

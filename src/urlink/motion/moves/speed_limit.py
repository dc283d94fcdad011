"""Speed limit of set-points: each joint has a time budget, and each motion of the joint uses a part of this budget.

If a joint cannot reach a set-point in time, the controller answers with a protective stop. Therefore every set-point is
checked here, even if urlink has computed it. A motion of x rad uses x / (largest speed of the joint) seconds of the
budget. Each second that passes adds one second to the budget, up to a maximum:

- if set-points are sent regularly: one period of the set-points plus `EARLY`;
- after a late set-point: additionally the delay of this set-point (at most `LATE`, unless another bound is given). Only
  the set-points that follow quickly can use the additional time. The first set-point that is on time again removes the
  unused additional time. Catching up causes no jump, because the program on the robot continues at the last speed
  during the delay (`urlink.script.streaming`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from numpy.typing import ArrayLike

from linkcore.arguments import check_number

from ...arm.bounds import JOINT_SPEED
from ...arm.models import Model
from ...arm.vectors import JOINTS, FloatArray, six

#: Largest time in s by which a set-point may be early. Chosen: longer than the jitter of a sleep in Python, but short
#: enough that early set-points do not stop the simulated arm at its largest speed.
EARLY = 0.001
#: Largest delay of a set-point, in s, that the next set-points may make up for at once. Chosen: a tenth of the default
#: watchdog.
LATE = 0.01
#: Longest period in s for which the limit is calculated. In a slower loop, the steps must not be larger, because the
#: arm executes each step at once.
LONGEST_PERIOD = 0.02

#: Rounding error of set-points, in rad, which is not counted as motion. Set-points are rounded to millionths.
_SLACK = 2e-6


def largest_speeds(model: Model | None) -> tuple[float, ...]:
    """Return the largest speeds, (6,) in rad/s; for an unknown arm, the speeds of the fastest arm."""
    return (JOINT_SPEED.most,) * 6 if model is None else tuple(model.max_speed.tolist())


def check_joint_speeds(values: ArrayLike, name: str, model: Model | None) -> FloatArray:
    """Check joint speeds, and return them as a read-only array, (6,) in rad/s.

    Raises:
        BadValue: If `values` is not six finite numbers, or if a speed is too fast for the arm. For an unknown arm, the
            limits of the fastest arm apply.
    """
    speeds = six(values, name)
    for joint, (value, limit) in enumerate(zip(speeds.tolist(), largest_speeds(model), strict=True)):
        whose = "the fastest arm" if model is None else f"a {model.name}"
        check_number(value, f"{name}[{joint}] ({JOINTS[joint]})", -limit, limit, "rad/s", whose)
    return speeds


class SpeedLimit:
    """Time budget of each joint: the time in s for which the joint may move at full speed.

    Args:
        speeds: Largest speeds of the joints, shape (6,), in rad/s.
        period: Time between two set-points, in s.
        late: Largest delay in s that set-points may make up for at once.

    The argument `now` of the methods is a monotonic time in s.
    """

    def __init__(self, speeds: Sequence[float], period: float, late: float = LATE) -> None:
        self._speeds = speeds
        self._period = min(period, LONGEST_PERIOD)
        self._even = self._period + EARLY
        self._late = late
        self._budget = [self._even] * 6
        self._at = math.inf

    def excess(self, before: Sequence[float], after: Sequence[float], now: float) -> str | None:
        """Return a message if a move from `before` to `after`, (6,) rad, is too fast now; None if it is permitted."""
        budgets = self._budgets(now)
        for joint, (here, there, speed, seconds) in enumerate(zip(before, after, self._speeds, budgets, strict=True)):
            most = speed * seconds + _SLACK
            if not abs(there - here) <= most:  # is also true for NaN
                return (
                    f"q[{joint}] ({JOINTS[joint]}) is {there:.4f} rad, {abs(there - here):.4f} rad from the last "
                    f"set-point; at most {most:.4f} rad by now, at {speed:.2f} rad/s"
                )
        return None

    def take(self, before: Sequence[float], after: Sequence[float], now: float) -> None:
        """Subtract the motion to a set-point from the budget. Call it after the set-point was sent."""
        self._budget = [
            max(seconds - abs(there - here) / speed, 0.0)
            for here, there, speed, seconds in zip(before, after, self._speeds, self._budgets(now), strict=True)
        ]
        self._at = now

    def _budgets(self, now: float) -> list[float]:
        """Return the time budget of each joint at the time `now`, in s."""
        passed = max(now - self._at, 0.0)
        if passed > 1.5 * self._period:
            ceiling = self._even + min(passed - self._period, self._late)
            return [min(left + passed, ceiling) for left in self._budget]
        if passed > 0.5 * self._period:
            return [min(left + passed, self._even) for left in self._budget]
        return [min(left + passed, max(self._even, left)) for left in self._budget]

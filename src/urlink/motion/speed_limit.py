"""How fast set-points may lead an arm: each joint has a budget of time, and the way that it is led uses it up.

A controller answers a set-point that a joint cannot reach in time with a protective stop, so every set-point is bounded
here, wherever it was computed. A joint that is led by x rad uses x / (its largest speed) seconds of its budget, and
each second that passes adds one, up to a ceiling:

- one period of the set-points and `EARLY`, as long as they leave evenly;
- after a late one, its lateness in addition (`LATE` at most, where nothing else is said), for the set-points that
  follow it at once. Meanwhile the program on the robot goes on at its last speed
  (`urlink.urscript.streaming`), so to catch up is no leap. The first set-point that is on time again gives up
  the rest.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from ..models import Model
from ..vectors import JOINTS

__all__ = ["EARLY", "LATE", "LONGEST_PERIOD", "SpeedLimit", "largest_speeds"]

#: Seconds by which a set-point may be early. Chosen: more than the jitter of a sleep in Python, and little enough that
#: the simulated arm, led at its largest speed, does not stop because of it.
EARLY = 0.001
#: Seconds of lateness that may be made up for at once. Chosen: a tenth of the default watchdog.
LATE = 0.01
#: Seconds: of a loop with a longer period a step is no larger than with this one, since the arm takes it in one cycle.
LONGEST_PERIOD = 0.02

#: rad/s of the fastest joint of any arm that is known, for arms of which nothing is known.
_FASTEST = 2.0 * math.pi
#: rad; set-points are rounded to millionths, which must not count as speed.
_SLACK = 2e-6


def largest_speeds(model: Model | None) -> tuple[float, ...]:
    """(6,) rad/s; of an arm that is not known, those of the fastest there is."""
    return (_FASTEST,) * 6 if model is None else tuple(model.max_speed.tolist())


class SpeedLimit:
    """The seconds that each joint may still be led at full speed.

    Args:
        model: whose speeds count; None for an arm that is not known, which gets that of the fastest.
        period: seconds between two set-points.
        late: seconds of lateness that may be made up for at once.

    The argument `now` of its methods is in seconds of a clock that only grows.
    """

    def __init__(self, model: Model | None, period: float, late: float = LATE) -> None:
        self._speeds = largest_speeds(model)
        self._period = min(period, LONGEST_PERIOD)
        self._even = self._period + EARLY
        self._late = late
        self._budget = [self._even] * 6
        self._at = math.inf

    def excess(self, before: Sequence[float], after: Sequence[float], now: float) -> str | None:
        """What is too fast about going on from `before` to `after` (6, rad) now; None if nothing is."""
        budgets = self._budgets(now)
        for joint, (here, there, speed, seconds) in enumerate(zip(before, after, self._speeds, budgets, strict=True)):
            most = speed * seconds + _SLACK
            if not abs(there - here) <= most:  # so that NaN is too far as well
                return (
                    f"q[{joint}] ({JOINTS[joint]}) is {there:.4f} rad, {abs(there - here):.4f} rad from the last "
                    f"set-point; at most {most:.4f} rad by now, at {speed:.2f} rad/s"
                )
        return None

    def take(self, before: Sequence[float], after: Sequence[float], now: float) -> None:
        """What `excess` let through has been sent."""
        self._budget = [
            max(seconds - abs(there - here) / speed, 0.0)
            for here, there, speed, seconds in zip(before, after, self._speeds, self._budgets(now), strict=True)
        ]
        self._at = now

    def _budgets(self, now: float) -> list[float]:
        """What each joint has at this time."""
        passed = max(now - self._at, 0.0)
        if passed > 1.5 * self._period:
            ceiling = self._even + min(passed - self._period, self._late)
            return [min(left + passed, ceiling) for left in self._budget]
        if passed > 0.5 * self._period:
            return [min(left + passed, self._even) for left in self._budget]
        return [min(left + passed, max(self._even, left)) for left in self._budget]

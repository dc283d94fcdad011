"""When the ticks of a host are due, and how late they came. Has no clock: the caller passes the time."""

from __future__ import annotations

from collections import deque

import numpy as np

__all__ = ["Schedule"]

#: Ticks whose lateness is remembered for its percentiles.
_REMEMBERED = 4096


class Schedule:
    """Ticks at a period.

    Each is due at its own absolute time, so that lateness does not add up. A tick that comes more than a period late
    is counted as an overrun; the whole periods that it missed are skipped and counted, and not made up for, since a
    robot that gets three ticks in a row would take three steps at once.

    Args:
        period: seconds.
        now: when it begins.

    Attributes:
        due: when the next tick is due.
        overruns: ticks that came more than a period late.
        skipped: periods without a tick.
        worst: seconds by which the latest of all came after it was due.
    """

    def __init__(self, period: float, now: float) -> None:
        self.due = now
        self.overruns = 0
        self.skipped = 0
        self.worst = 0.0
        self._period = period
        self._late: deque[float] = deque(maxlen=_REMEMBERED)

    def advance(self) -> float:
        """Go on to the next tick; when it is due."""
        self.due += self._period
        return self.due

    def postpone(self, seconds: float) -> None:
        """The tick is waited for by the host, and is not late because of that."""
        self.due += max(seconds, 0.0)

    def came(self, now: float) -> None:
        """The tick has come."""
        late = now - self.due
        self._late.append(late)
        self.worst = max(self.worst, late)
        if late > self._period:
            periods = int(late / self._period)
            self.overruns += 1
            self.skipped += periods
            self.due += periods * self._period

    def lateness(self) -> tuple[float, float]:
        """Seconds, of the last 4096 ticks: the median, and what one in a hundred exceeds. From any thread."""
        # The host's thread may be adding to it. A deque is copied in one go, where going through it would fail then.
        late = list(self._late.copy())
        if not late:
            return 0.0, 0.0
        median, p99 = np.percentile(late, (50, 99)).tolist()
        return median, p99

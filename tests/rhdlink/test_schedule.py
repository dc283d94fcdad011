"""Due times of ticks, by examples; the property for any delay is in test_host."""

from __future__ import annotations

import numpy as np
import pytest

from rhdlink.host.server import TickSchedule


def ticked(*lateness: float) -> TickSchedule:
    """Return a schedule with a period of one second, after one tick for each of these delays."""
    schedule = TickSchedule(1.0, 100.0)
    for late in lateness:
        schedule.came(schedule.advance() + late)
    return schedule


def test_tick_is_due_a_whole_period_after_the_previous() -> None:
    assert ticked().due == 100.0
    assert ticked().advance() == 101.0
    assert ticked(0.9).advance() == 102.0
    # A delay of a whole period is not an overrun yet, because the next tick is only just due.
    schedule = ticked(1.0)
    assert (schedule.overruns, schedule.skipped, schedule.advance()) == (0, 0, 102.0)


def test_missed_periods_are_skipped() -> None:
    schedule = ticked(3.5)
    assert (schedule.overruns, schedule.skipped, schedule.due) == (1, 3, 104.0)
    assert schedule.advance() == 105.0
    schedule = ticked(1.25, 0.0, 2.5)
    assert (schedule.overruns, schedule.skipped, schedule.worst) == (2, 3, 2.5)
    schedule = TickSchedule(0.5, 100.0)
    schedule.came(schedule.advance() + 1.25)
    assert (schedule.skipped, schedule.due) == (2, 101.5)


def test_postponed_tick_is_not_late() -> None:
    schedule = TickSchedule(1.0, 100.0)
    schedule.advance()
    schedule.postpone(0.75)
    schedule.came(101.75)
    assert (schedule.due, schedule.worst) == (101.75, 0.0)
    schedule.postpone(-0.5)  # a clock that was set back
    assert schedule.due == 101.75


def test_lateness_is_median_and_p99_of_the_last_ticks() -> None:
    assert ticked().lateness() == (0.0, 0.0)
    late = [number / 1000 for number in range(200)]
    median, p99 = ticked(*late).lateness()
    assert (median, p99) == pytest.approx((np.percentile(late, 50), np.percentile(late, 99)))
    # Only the last 4096 ticks count, half of which were 0.5 s late: one more or fewer would change the median.
    median, p99 = ticked(0.0, *[0.0, 0.5] * 2048).lateness()
    assert (median, p99) == pytest.approx((0.25, 0.5))

"""Simulated time that advances by calls of a step function."""

from __future__ import annotations

import pytest

from linkcore.errors import LinkTimeout
from tests.waiting import until
from urlink.simulator.control_loop import passing


@pytest.mark.simulated_time
def test_simulated_time_continues_after_a_step_times_out() -> None:
    steps: list[int] = []

    def step(cycles: int) -> None:
        steps.append(cycles)
        if len(steps) == 2:
            raise LinkTimeout("the simulator did not come to it within 5 s")

    with passing(step, 500, 10.0):
        until(lambda: len(steps) > 4)
    assert set(steps) == {5}

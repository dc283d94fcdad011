"""The time of a program, state by state. (The controller's clock is with the follower.)"""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import cast

import pytest

from urlink.interfaces.enums import ProgramState
from urlink.interfaces.realtime.packets import RealtimeState
from urlink.motion.controller_clock import ProgramClock, is_paused, reported_scaling

PLAYING, PAUSING, PAUSED = ProgramState.PLAYING, ProgramState.PAUSING, ProgramState.PAUSED


def state(scaling: float | None, program: ProgramState | None = PLAYING, time: float = 50.0) -> RealtimeState:
    return cast(RealtimeState, SimpleNamespace(time=time, speed_scaling=scaling, program_state=program))


@pytest.mark.parametrize(
    ("scaling", "program", "rate"),
    [
        (None, None, 1.0),  # CB2
        (0.3, None, 0.3),  # 3.0
        (0.3, PLAYING, 0.3),
        (0.0, PLAYING, 0.0),
        (1.0, PAUSED, 0.0),  # 3.2 to 3.9
        (1.0, PAUSING, 0.0),
        (math.nan, PLAYING, 1.0),
        (-0.1, PLAYING, 1.0),
        (1.5, PLAYING, 1.0),
    ],
)
def test_how_fast_a_program_is(scaling: float | None, program: ProgramState | None, rate: float) -> None:
    assert reported_scaling(state(scaling, program)) == rate
    assert is_paused(state(scaling, program)) == (program in (PAUSED, PAUSING))


def test_its_time_is_the_controllers_by_the_mean_of_two_states() -> None:
    clock, wall = ProgramClock(0.002), ProgramClock(0.002, "ignore")
    seen = [(0.5, 0.0), (0.5, 0.002), (1.0, 0.002), (0.0, 0.01), (0.0, 1.0), (0.2, 0.002)]
    expected, now = [0.0, 0.001, 0.0015, 0.005, 0.0, 0.0002], 0.0
    for (scaling, later), scaled in zip(seen, expected, strict=True):
        now += later
        each = state(scaling, time=50.0 + now)
        assert clock.passed(each, now) == pytest.approx((later, scaled))
        assert clock.rate == scaling
        assert wall.passed(each, now) == pytest.approx((later, later))
        assert wall.rate == 1.0

"""The budget of speed, on a clock that the test sets."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from urlink.arm.models import MODELS, model
from urlink.motion.moves.speed_limit import EARLY, LATE, LONGEST_PERIOD, SpeedLimit, largest_speeds

UR5E = model("UR5e")
#: rad/s of each joint of a UR5e.
TOP = math.pi


class Loop:
    """Leads wrist 3 by steps; `at` is the clock."""

    def __init__(self, period: float = 0.002, name: str | None = "UR5e") -> None:
        self.at = 100.0
        self.q = 0.0
        self.limit = SpeedLimit(largest_speeds(None if name is None else model(name)), period)
        self.limit.take([0.0] * 6, [0.0] * 6, self.at)

    def step(self, way: float, seconds: float) -> str | None:
        """Go `way` rad on, `seconds` after the last time; what was refused."""
        self.at += seconds
        before, after = [0.0] * 5 + [self.q], [0.0] * 5 + [self.q + way]
        excess = self.limit.excess(before, after, self.at)
        if excess is None:
            self.limit.take(before, after, self.at)
            self.q += way
        return excess


@pytest.mark.parametrize("direction", [1, -1])
def test_a_loop_at_full_speed_passes_for_ever(direction: int) -> None:
    loop = Loop()
    for _ in range(10_000):
        assert loop.step(direction * TOP * 0.002, 0.002) is None


@pytest.mark.parametrize("speed", [1.05, 1.3, 2.0, 5.0])
def test_a_loop_that_is_too_fast_is_refused_before_it_gets_far(speed: float) -> None:
    loop = Loop()
    steps = 0
    while loop.step(speed * TOP * 0.002, 0.002) is None:
        steps += 1
        assert steps < 100
    # What it has been led by more than the arm can follow is no more than what a set-point may be early.
    assert loop.q - TOP * 0.002 * steps <= TOP * EARLY + 1e-4


def test_back_to_back_is_refused() -> None:
    loop = Loop()
    taken = sum(loop.step(0.02, 1e-5) is None for _ in range(30))
    assert taken == 0
    taken = sum(loop.step(0.001, 1e-5) is None for _ in range(30))
    assert taken * 0.001 <= TOP * (0.002 + EARLY + 30e-5) + 1e-6


@pytest.mark.parametrize(("speed", "late", "passes"), [(0.5, 0.06, True), (1.5, 0.02, True), (3.0, 0.008, True)])
def test_a_hiccup_that_can_be_made_up_for(speed: float, late: float, passes: bool) -> None:
    """A loop that keeps to absolute times is late once, and then sends what it missed at once."""
    loop = Loop()
    for _ in range(100):
        assert loop.step(speed * 0.002, 0.002) is None
    missed = round(late / 0.002)
    refused = [loop.step(speed * 0.002, late if n == 0 else 2e-5) for n in range(missed)]
    assert refused == [None] * missed
    for _ in range(100):
        assert loop.step(speed * 0.002, 0.002) is None


def test_a_hiccup_that_is_too_long_is_not_made_up_for_at_once() -> None:
    loop = Loop()
    for _ in range(100):
        loop.step(3.0 * 0.002, 0.002)
    refused = [loop.step(3.0 * 0.002, 0.05 if n == 0 else 2e-5) for n in range(25)]
    assert refused[0] is None
    assert any(refused)


def test_lateness_counts_from_when_a_set_point_was_due() -> None:
    """One that comes after two periods is one period late."""
    assert Loop().step(TOP * (0.004 + EARLY) * 1.01, 0.004) is not None
    assert Loop().step(TOP * (0.004 + EARLY) * 0.99, 0.004) is None


def test_lateness_that_nobody_made_up_for_is_given_up() -> None:
    """Otherwise a loop could save it up, and leap at full speed."""
    loop = Loop()
    loop.step(0.0, 1.0)
    loop.step(TOP * 0.002, 0.002)
    assert loop.step(TOP * (0.002 + EARLY) * 1.1, 0.002) is not None


def test_a_pause_is_no_leave_to_leap() -> None:
    loop = Loop()
    assert loop.step(TOP * (0.002 + EARLY + LATE) * 1.01, 60.0) is not None
    assert loop.step(TOP * (0.002 + EARLY + LATE) * 0.99, 0.0) is None


def test_jitter_of_a_millisecond_passes_at_full_speed() -> None:
    loop = Loop(0.008, "UR5")
    for n in range(1000):
        assert loop.step(TOP * 0.008, 0.008 + (EARLY if n % 2 else -EARLY)) is None


def test_a_loop_that_sends_several_in_each_period_passes_for_ever() -> None:
    loop = Loop()
    for _ in range(1000):
        assert loop.step(TOP * 0.0005, 0.0005) is None


def test_the_bounds_in_numbers() -> None:
    """2 ms of a period, 1 ms that a set-point may be early, 10 ms that it may be late; two millionths for rounding."""
    for seconds, room, period in ((0.002, 0.003, 0.002), (60.0, 0.013, 0.002), (60.0, 0.031, 9.0), (0.02, 0.021, 9.0)):
        assert Loop(period).step(TOP * room + 2.1e-6, seconds) is not None
        assert Loop(period).step(TOP * room + 1.9e-6, seconds) is None
    # What is just within them passes.
    assert Loop().step(TOP * (0.002 + EARLY) + 2e-6, 0.002) is None


def test_a_slow_loop_leads_no_further_in_a_step_than_one_at_50_hz() -> None:
    loop = Loop(0.5)
    assert loop.step(TOP * (LONGEST_PERIOD + EARLY + LATE) * 1.01, 0.5) is not None
    assert loop.step(TOP * (LONGEST_PERIOD + EARLY) * 0.99, 0.0) is None


@pytest.mark.parametrize("way", [float("nan"), float("inf"), -float("inf"), 1e300])
def test_what_is_no_way_is_refused(way: float) -> None:
    assert Loop().step(way, 0.002) is not None


def test_an_arm_that_nobody_knows_is_as_fast_as_the_fastest_there_is() -> None:
    fastest = max(float(arm.max_speed.max()) for arm in MODELS.values())
    loop = Loop(0.002, None)
    assert loop.step(fastest * 0.002, 0.002) is None
    assert loop.step(fastest * 0.0031, 0.002) is not None
    assert largest_speeds(None) == (fastest,) * 6


def test_says_which_joint_and_by_how_much() -> None:
    limit = SpeedLimit(largest_speeds(model("UR10e")), 0.002)
    said = limit.excess([0.0] * 6, [0.0, -0.5, 0.0, 0.0, 0.0, 0.0], 0.0)
    assert said is not None
    for part in ("q[1] (shoulder)", "-0.5000 rad", "0.5000 rad from the last", "at most 0.0063 rad", "2.09 rad/s"):
        assert part in said


def test_a_clock_that_stands_still_or_goes_back_gives_nothing() -> None:
    loop = Loop()
    while loop.step(0.001, 0.0) is None:
        pass
    assert loop.step(0.001, -5.0) is not None


@pytest.mark.property
@given(
    st.lists(
        st.tuples(st.floats(-0.1, 0.1), st.one_of(st.floats(0, 0.005), st.floats(0, 2.0), st.just(0.002))), max_size=60
    ),
    st.sampled_from([0.002, 0.008, 0.02, 1.0]),
)
def test_whatever_the_pattern_the_way_is_bounded(steps: list[tuple[float, float]], period: float) -> None:
    loop = Loop(period)
    times, ways = [loop.at], [0.0]
    for way, seconds in steps:
        if loop.step(way, seconds) is None:
            times.append(loop.at)
            ways.append(abs(way))
    room = min(period, LONGEST_PERIOD) + EARLY + LATE
    for first in range(len(times)):
        for last in range(first + 1, len(times)):
            # From just before the set-point after `first` to that of `last`.
            way = sum(ways[first + 1 : last + 1])
            assert way <= TOP * (times[last] - times[first + 1] + room) + 1e-5 * len(times)

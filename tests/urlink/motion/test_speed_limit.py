"""The speed limit, which works like a budget, on a clock that the test controls."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from urlink.arm.models import MODELS, model
from urlink.motion.moves.speed_limit import EARLY, LATE, LONGEST_PERIOD, SpeedLimit, largest_speeds

UR5E = model("UR5e")
#: Speed limit of each joint of a UR5e, in rad/s.
TOP = math.pi


class Loop:
    """A loop that moves wrist 3 in steps; `at` is the clock."""

    def __init__(self, period: float = 0.002, name: str | None = "UR5e") -> None:
        self.at = 100.0
        self.q = 0.0
        self.limit = SpeedLimit(largest_speeds(None if name is None else model(name)), period)
        self.limit.take([0.0] * 6, [0.0] * 6, self.at)

    def step(self, way: float, seconds: float) -> str | None:
        """Move by `way` rad, `seconds` after the last step; return the reason if it is rejected."""
        self.at += seconds
        before, after = [0.0] * 5 + [self.q], [0.0] * 5 + [self.q + way]
        excess = self.limit.excess(before, after, self.at)
        if excess is None:
            self.limit.take(before, after, self.at)
            self.q += way
        return excess


@pytest.mark.parametrize("direction", [1, -1])
def test_loop_at_full_speed_is_always_accepted(direction: int) -> None:
    loop = Loop()
    for _ in range(10_000):
        assert loop.step(direction * TOP * 0.002, 0.002) is None


@pytest.mark.parametrize("speed", [1.05, 1.3, 2.0, 5.0])
def test_too_fast_loop_is_rejected_early(speed: float) -> None:
    loop = Loop()
    steps = 0
    while loop.step(speed * TOP * 0.002, 0.002) is None:
        steps += 1
        assert steps < 100
    # The loop is ahead of the arm by no more than a set-point may be early.
    assert loop.q - TOP * 0.002 * steps <= TOP * EARLY + 1e-4


def test_steps_without_time_between_are_rejected() -> None:
    loop = Loop()
    taken = sum(loop.step(0.02, 1e-5) is None for _ in range(30))
    assert taken == 0
    taken = sum(loop.step(0.001, 1e-5) is None for _ in range(30))
    assert taken * 0.001 <= TOP * (0.002 + EARLY + 30e-5) + 1e-6


@pytest.mark.parametrize(("speed", "late", "passes"), [(0.5, 0.06, True), (1.5, 0.02, True), (3.0, 0.008, True)])
def test_loop_may_catch_up_after_a_short_delay(speed: float, late: float, passes: bool) -> None:
    """A loop with absolute times is late once, and then sends the missed set-points at once."""
    loop = Loop()
    for _ in range(100):
        assert loop.step(speed * 0.002, 0.002) is None
    missed = round(late / 0.002)
    refused = [loop.step(speed * 0.002, late if n == 0 else 2e-5) for n in range(missed)]
    assert refused == [None] * missed
    for _ in range(100):
        assert loop.step(speed * 0.002, 0.002) is None


def test_loop_may_not_catch_up_at_once_after_a_long_delay() -> None:
    loop = Loop()
    for _ in range(100):
        loop.step(3.0 * 0.002, 0.002)
    refused = [loop.step(3.0 * 0.002, 0.05 if n == 0 else 2e-5) for n in range(25)]
    assert refused[0] is None
    assert any(refused)


def test_lateness_counts_from_due_time() -> None:
    """A set-point that comes after two periods is one period late."""
    assert Loop().step(TOP * (0.004 + EARLY) * 1.01, 0.004) is not None
    assert Loop().step(TOP * (0.004 + EARLY) * 0.99, 0.004) is None


def test_unused_motion_budget_of_a_late_set_point_expires() -> None:
    """Otherwise, a loop could save it up and then jump at full speed."""
    loop = Loop()
    loop.step(0.0, 1.0)
    loop.step(TOP * 0.002, 0.002)
    assert loop.step(TOP * (0.002 + EARLY) * 1.1, 0.002) is not None


def test_pause_does_not_permit_a_jump() -> None:
    loop = Loop()
    assert loop.step(TOP * (0.002 + EARLY + LATE) * 1.01, 60.0) is not None
    assert loop.step(TOP * (0.002 + EARLY + LATE) * 0.99, 0.0) is None


def test_jitter_of_a_millisecond_passes_at_full_speed() -> None:
    loop = Loop(0.008, "UR5")
    for n in range(1000):
        assert loop.step(TOP * 0.008, 0.008 + (EARLY if n % 2 else -EARLY)) is None


def test_several_set_points_per_period_are_accepted() -> None:
    loop = Loop()
    for _ in range(1000):
        assert loop.step(TOP * 0.0005, 0.0005) is None


def test_speed_limit_bounds_have_expected_values() -> None:
    """The bounds are 2 ms for the period, 1 ms early and 10 ms late, and two millionths of a rad for rounding."""
    for seconds, room, period in ((0.002, 0.003, 0.002), (60.0, 0.013, 0.002), (60.0, 0.031, 9.0), (0.02, 0.021, 9.0)):
        assert Loop(period).step(TOP * room + 2.1e-6, seconds) is not None
        assert Loop(period).step(TOP * room + 1.9e-6, seconds) is None
    # A step just within the bounds passes.
    assert Loop().step(TOP * (0.002 + EARLY) + 2e-6, 0.002) is None


def test_step_of_slow_loop_is_limited_as_at_50_hz() -> None:
    loop = Loop(0.5)
    assert loop.step(TOP * (LONGEST_PERIOD + EARLY + LATE) * 1.01, 0.5) is not None
    assert loop.step(TOP * (LONGEST_PERIOD + EARLY) * 0.99, 0.0) is None


@pytest.mark.parametrize("way", [float("nan"), float("inf"), -float("inf"), 1e300])
def test_invalid_distance_is_rejected(way: float) -> None:
    assert Loop().step(way, 0.002) is not None


def test_unknown_arm_uses_speed_of_fastest_arm() -> None:
    fastest = max(float(arm.max_speed.max()) for arm in MODELS.values())
    loop = Loop(0.002, None)
    assert loop.step(fastest * 0.002, 0.002) is None
    assert loop.step(fastest * 0.0031, 0.002) is not None
    assert largest_speeds(None) == (fastest,) * 6


def test_error_names_joint_and_excess() -> None:
    limit = SpeedLimit(largest_speeds(model("UR10e")), 0.002)
    said = limit.excess([0.0] * 6, [0.0, -0.5, 0.0, 0.0, 0.0, 0.0], 0.0)
    assert said is not None
    for part in ("q[1] (shoulder)", "-0.5000 rad", "0.5000 rad from the last", "at most 0.0063 rad", "2.09 rad/s"):
        assert part in said


def test_speed_limit_grants_no_motion_if_the_clock_stands_still() -> None:
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
def test_distance_is_bounded_for_any_pattern(steps: list[tuple[float, float]], period: float) -> None:
    loop = Loop(period)
    times, ways = [loop.at], [0.0]
    for way, seconds in steps:
        if loop.step(way, seconds) is None:
            times.append(loop.at)
            ways.append(abs(way))
    room = min(period, LONGEST_PERIOD) + EARLY + LATE
    for first in range(len(times)):
        for last in range(first + 1, len(times)):
            # Add the steps after the set-point that follows `first`, up to `last`.
            way = sum(ways[first + 1 : last + 1])
            assert way <= TOP * (times[last] - times[first + 1] + room) + 1e-5 * len(times)

"""Jerk-limited profiles from any state to rest at a target, and servos that use them."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from linkcore.errors import BadValue
from tests.fakes.rehearsal import HOME, turned
from tests.urlink.motion.bench import Led
from urlink.arm.models import model
from urlink.motion.servo.jerk_limited import JointLimit, JointProfile, TargetFilter, joint_limits
from urlink.motion.servo.resampling import FilteredTargets
from urlink.protocol.firmware import Firmware

_limits = st.builds(JointLimit, st.floats(0.05, 4.0), st.floats(0.1, 40.0), st.floats(0.5, 500.0))
_part = st.one_of(st.just(0.0), st.floats(-1.0, 1.0))
_FIRMWARES = [Firmware.parse(each) for each in ("1.8", "3.15", "5.25")]


@pytest.mark.property
@given(limit=_limits, v=_part, a=_part, way=st.one_of(st.just(0.0), st.floats(-7.0, 7.0), st.floats(-1e-6, 1e-6)))
def test_profile_respects_limits_and_arrives(limit: JointLimit, v: float, a: float, way: float) -> None:
    v, a = v * limit.speed, a * limit.acceleration
    assume(abs(v + 0.5 * a * abs(a) / limit.jerk) <= limit.speed)
    profile = JointProfile(1.0, v, a, 1.0 + way, limit)
    times = np.linspace(0.0, profile.duration, 101)
    states = np.array([profile.at(t) for t in times])
    assert np.abs(states[:, 1]).max() <= limit.speed * (1 + 1e-9)
    assert np.abs(states[:, 2]).max() <= limit.acceleration * (1 + 1e-9)
    if profile.duration > 1e-9:
        changes = np.diff(states[:, 2]) / times[1]
        assert np.abs(changes).max() <= limit.jerk * (1 + 1e-6) + 1e-9 / times[1]
        assert states[0] == pytest.approx([1.0, v, a], abs=1e-12)
    assert profile.at(profile.duration) == (1.0 + way, 0.0, 0.0)
    # The profile arrives on its own, without a correction at the end.
    assert profile.at(math.nextafter(profile.duration, 0.0)) == pytest.approx((1.0 + way, 0.0, 0.0), abs=1e-6)
    assert profile.at(math.nextafter(profile.duration, 0.0))[0] == pytest.approx(1.0 + way, abs=1e-11)


def test_rest_to_rest_takes_minimal_time() -> None:
    """Compare with textbook formulas, one example for each shape of the profile."""
    assert JointProfile(0, 0, 0, 2.0, JointLimit(10, 10, 1)).duration == pytest.approx(4.0)  # 4 (x / 2j)^(1/3)
    assert JointProfile(0, 0, 0, -6.0, JointLimit(10, 1, 1)).duration == pytest.approx(6.0)  # at the acceleration limit
    assert JointProfile(0, 0, 0, 10.0, JointLimit(1, 1, 1)).duration == pytest.approx(12.0)  # and at the speed limit
    assert JointProfile(3, 0, 0, 3.0, JointLimit(1, 1, 1)).duration == 0.0


#: speed, acceleration and its limit; braking distance and time, integrated by hand with a jerk of 1
BRAKING = [
    (1.0, 0.0, 10.0, 1.0, 2.0),
    (4.0, 0.0, 1.0, 10.0, 5.0),
    (7.0, 2.0, 10.0, 131.0 / 3.0, 8.0),
    (7.0, -2.0, 10.0, 31.0 / 3.0, 4.0),
    (12.25, -4.0, 10.0, 499.0 / 24.0, 5.0),
    (1.0, -2.0, 10.0, -5.0 / 3.0, 4.0),
    (7.0, 2.0, 2.0, 45.0 + 11.0 / 12.0, 8.5),
    (0.0, 0.0, 1.0, 0.0, 0.0),
]


@pytest.mark.parametrize(("v", "a", "most", "way", "seconds"), BRAKING)
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_profile_only_brakes_if_braking_ends_at_target(
    sign: float, v: float, a: float, most: float, way: float, seconds: float
) -> None:
    """For a target further away, the profile accelerates first; for a nearer one, it overshoots. Both take longer."""
    limit = JointLimit(100.0, most, 1.0)
    assert JointProfile(0.5, sign * v, sign * a, 0.5 + sign * way, limit).duration == pytest.approx(seconds, abs=1e-4)
    for further in (0.05, -0.05):
        target = 0.5 + sign * (way + further)
        profile = JointProfile(0.5, sign * v, sign * a, target, limit)
        assert seconds < profile.duration < seconds + 2.0
        states = np.array([profile.at(t) for t in np.linspace(0.0, profile.duration, 400, endpoint=False)])
        assert states[-1] == pytest.approx([target, 0.0, 0.0], abs=0.05)
        if v * way > 0.0:
            is_beyond = (sign * (states[:, 0] - target) > 1e-9).any()
            assert is_beyond == (further < 0.0)


def rests_at_target(led: TargetFilter) -> bool:
    return (led.q, led.qd, led.qdd) == (led.target, [0.0] * 6, [0.0] * 6)


def test_filter_reaches_target_in_time_and_stays() -> None:
    limit = JointLimit(1.0, 1.0, 1.0)
    led = TargetFilter([0.5] * 6, [limit] * 6)
    led.advance(1.0)
    is_there = [rests_at_target(led)]
    assert (led.q, led.qd, led.qdd) == ([0.5] * 6, [0.0] * 6, [0.0] * 6)
    led.aim([0.5] * 5 + [2.5])
    is_there.append(rests_at_target(led))
    led.advance(JointProfile(0.5, 0.0, 0.0, 2.5, limit).duration)
    is_there.append(rests_at_target(led))
    assert is_there == [True, False, True]
    assert led.q == led.target == [0.5] * 5 + [2.5]


def test_filter_rests_until_target_changes() -> None:
    targets = TargetFilter([0.3] * 6, [JointLimit(1.0, 2.0, 10.0)] * 6)
    for _ in range(2):
        targets.aim([0.3] * 6)
        for seconds in (0.0, 0.5, 2.0):
            assert targets.after(seconds) == ([0.3] * 6, [0.0] * 6)
        targets.advance(0.5)
    assert (targets.q, targets.qd, targets.qdd) == ([0.3] * 6, [0.0] * 6, [0.0] * 6)


def test_restart_respects_limits() -> None:
    """At or above the largest speed, the acceleration is dropped; below it, as much as the limit allows is kept."""
    limit = JointLimit(1.0, 4.0, 60.0)
    led = TargetFilter([0.0] * 6, [limit] * 6)
    led.aim([2.0, 2.0, 2.0, -2.0, -2.0, -2.0])
    led.advance(0.05)
    assert np.abs(led.qdd) == pytest.approx([3.0] * 6)
    led.restart([0.1] * 6, [1.0, -5.0, 0.97, -1.5, 5.0, -0.97])
    assert led.qd == [1.0, -1.0, 0.97, -1.0, 1.0, -0.97]
    assert led.q == [0.1] * 6
    kept = math.sqrt(2.0 * 60.0 * 0.03)  # the speed grows by a² / 2j while the acceleration falls to zero
    assert led.qdd == pytest.approx([0.0, 3.0, kept, 0.0, -3.0, -kept])
    seen = []
    while not rests_at_target(led):
        led.advance(0.001)
        seen.append((led.qd, led.qdd))
        assert len(seen) < 5000
        led.qd, led.qdd = list(led.qd), list(led.qdd)
    assert led.q == [2.0, 2.0, 2.0, -2.0, -2.0, -2.0]
    fastest, hardest = np.abs(np.array(seen)).max(axis=0)
    assert fastest == pytest.approx([1.0] * 6, abs=1e-9)
    assert (hardest <= 4.0 + 1e-9).all()


@pytest.mark.property
@given(
    limits=st.lists(_limits, min_size=6, max_size=6),
    course=st.lists(
        st.tuples(st.lists(st.floats(-3.0, 3.0), min_size=6, max_size=6), st.floats(0.0, 0.5)), min_size=1, max_size=6
    ),
)
def test_filter_respects_limits_for_any_targets(
    limits: list[JointLimit], course: list[tuple[list[float], float]]
) -> None:
    """Targets may also come between two cycles. The motion is sampled as finely as a robot samples it."""
    led = TargetFilter([0.5] * 6, limits)
    most = np.array([[each.speed, each.acceleration, each.jerk] for each in limits]).T
    low, high = np.full(6, 0.5), np.full(6, 0.5)
    for target, seconds in course:
        led.aim(target)
        low, high = np.minimum(low, target), np.maximum(high, target)
        for _ in range(4):
            before = np.array([led.q, led.qd, led.qdd])
            promised = led.after(seconds / 4)
            led.advance(seconds / 4)
            assert (led.q, led.qd) == promised
            now = np.array([led.q, led.qd, led.qdd])
            if seconds > 1e-3:
                # Mean speed, acceleration and jerk between samples, as seen from outside.
                means = np.abs(now - before) / (seconds / 4)
                assert (means <= most * (1 + 1e-9) + 1e-9).all()
            assert (np.abs(now[1:]) <= most[:2] * (1 + 1e-9)).all()
            assert ((low - 1e-9 <= now[0]) & (now[0] <= high + 1e-9)).all()
    led.advance(2000.0)
    assert rests_at_target(led)
    assert led.q == course[-1][0]
    assert led.qd == led.qdd == [0.0] * 6


class Loop(Led):
    """A servo with a target filter."""

    def __init__(self, firmware: Firmware, speed: float, acceleration: float, jerk: float) -> None:
        limits = joint_limits(model("UR5e"), speed, acceleration, jerk)
        self.targets = FilteredTargets(limits, 1.0 / firmware.rate)
        super().__init__(firmware, self.targets)


@pytest.mark.slow
@pytest.mark.parametrize("firmware", _FIRMWARES, ids=str)
def test_servo_respects_limits_when_targets_jump(firmware: Firmware) -> None:
    """Run the program on the robot and its simulated arm, on each generation."""
    loop = Loop(firmware, 1.0, 4.0, 60.0)
    loop.run(5)
    assert loop.sent == []
    rng = np.random.default_rng(3)
    for _ in range(8):
        loop.targets.newest = turned(float(rng.uniform(-1, 1)), [h + float(rng.uniform(-0.4, 0.4)) for h in HOME])
        loop.run(int(rng.integers(1, firmware.rate // 3)))
    loop.run(3 * firmware.rate)
    assert loop.bench.said == []
    assert loop.bench.path[-1] == pytest.approx(loop.targets.newest, abs=1e-5)
    # Set-points are rounded to millionths, which is noise in the third difference.
    cycle = loop.bench.period
    for order, most in ((1, 1.0), (2, 4.0), (3, 60.0)):
        seen = np.abs(np.diff(np.array(loop.sent), order, axis=0)).max() / cycle**order
        assert seen <= most + 2 ** (order - 1) * 1e-6 / cycle**order
        assert seen > 0.6 * most


@pytest.mark.slow
@pytest.mark.parametrize("firmware", [_FIRMWARES[0], _FIRMWARES[2]], ids=str)
def test_delayed_servo_continues_without_jump(firmware: Firmware) -> None:
    """Continue from the position that the program on the robot has reached meanwhile."""
    loop = Loop(firmware, 1.0, 4.0, 60.0)
    loop.targets.newest = turned(2.0)
    loop.run(firmware.rate // 2)
    for missed in (1, 3, 8):
        loop.run(20, missed=missed)
        steps = np.diff(np.array(loop.bench.path)[-20:, 5]) / loop.bench.period
        assert steps.max() < 1.01
        assert np.abs(np.diff(steps)).max() < 0.15 + 0.1 * firmware.is_cb2  # change of speed per cycle, rad/s
    loop.run(3 * firmware.rate)
    assert loop.bench.path[-1] == pytest.approx(turned(2.0), abs=1e-5)
    loop.run(firmware.rate // 4, missed=firmware.rate // 4)
    assert loop.bench.said == ["urlink: nothing to go to"]


@pytest.mark.parametrize(
    ("limits", "message"),
    [
        ((4.0, 1.0, 1.0), r"speed\[0\] \(base\) is 4 rad/s; expected .* 3.14159 rad/s, the limits of a UR5e"),
        ((1.0, [1, 1, 1, 50, 1, 1], 1.0), r"acceleration\[3\] \(wrist 1\) is 50"),
        ((1.0, 1.0, 0.0), "jerk is .* expected positive limits"),
        ((1.0, [1, 2], 1.0), "shape"),
    ],
)
def test_invalid_limits_are_rejected(limits: tuple[float, float, float], message: str) -> None:
    with pytest.raises(BadValue, match=message):
        joint_limits(model("UR5e"), *limits)


def test_limits_may_equal_maximum_of_arm() -> None:
    arm = model("UR5e")
    limits = joint_limits(arm, arm.max_speed, arm.max_acceleration, [1, 2, 3, 4, 5, 6])
    assert [each.speed for each in limits] == arm.max_speed.tolist()
    assert [each.acceleration for each in limits] == arm.max_acceleration.tolist()
    assert [each.jerk for each in limits] == [1, 2, 3, 4, 5, 6]
    assert joint_limits(None, 100.0, 1e4, 1e5) == (JointLimit(100.0, 1e4, 1e5),) * 6

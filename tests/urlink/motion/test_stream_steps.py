"""Steps of a stream: polynomials, braking times, and limits for a path back to the points."""

from __future__ import annotations

import contextlib
import itertools
import math

import numpy as np
import pytest

from linkcore.errors import BadValue
from urlink.arm.models import model
from urlink.motion.servo.jerk_limited import JointLimit
from urlink.motion.stream.stream_steps import Aim, Bounds, JointMoment, Step, _sampled, onto
from urlink.script.buffering import BRAKING_FACTOR, STRAY

LIMITS = (JointLimit(3.0, 2.0, 50.0),) * 6


def moment(speed: float, acceleration: float) -> JointMoment:
    """Return a moment with only one joint moving."""
    others = [0.0] * 5
    return JointMoment(np.zeros(6), np.array([speed, *others]), np.array([acceleration, *others]))


@pytest.mark.parametrize(
    ("speed", "acceleration", "seconds"),
    [
        (0.0, 0.0, 0.0),
        (2.0, 0.0, BRAKING_FACTOR * 2.0 / 2.0),  # limited by the largest acceleration
        (0.02, 0.0, math.sqrt(6.0 * 0.02 / 50.0)),  # limited by the largest jerk
        (0.0, 1.0, 4.0 / 50.0),  # as is an acceleration that falls to zero
        (0.0, 4.0, 16.0 / 50.0),
        (0.0, 5.2, math.sqrt(12.0 * STRAY / 5.2)),  # must not move a joint further than it may stray
        (0.0, 90.0, math.sqrt(12.0 * STRAY / 90.0)),
        (0.9, 90.0, math.sqrt(6.0 * 0.9 / 50.0)),
    ],
)
def test_braking_step_has_expected_duration(speed: float, acceleration: float, seconds: float) -> None:
    slow = (JointLimit(3.0, 100.0, 50.0),) * 6 if acceleration or speed < 0.1 else LIMITS
    for sign in (1.0, -1.0):
        step = Step.braking(moment(sign * speed, sign * acceleration), slow)
        assert step.length == pytest.approx(seconds, rel=1e-9)
        assert step.end.qd == pytest.approx([0.0] * 6, abs=1e-9)
    if acceleration and not speed:
        assert abs(step.end.q[0]) <= STRAY + 1e-9


# -- polynomials -------------------------------------------------------------------------------------------


def random_moment(rng: np.random.Generator, size: float = 1.0) -> JointMoment:
    q, qd, qdd = size * rng.uniform(-1.0, 1.0, (3, 6))
    return JointMoment(q, qd, qdd)


def same(one: JointMoment, other: JointMoment, *names: str) -> bool:
    return all(getattr(one, name) == pytest.approx(getattr(other, name), abs=1e-9) for name in names)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize(("degree", "met"), [(1, ["q"]), (3, ["q", "qd"]), (5, ["q", "qd", "qdd"])])
def test_step_reaches_begin_and_end_for_each_degree(degree: int, met: list[str], seed: int) -> None:
    rng = np.random.default_rng(seed)
    begin, end, length = random_moment(rng), random_moment(rng), float(rng.uniform(0.1, 2.0))
    step = Step.to(begin, end, length, degree)
    assert same(step.begin, begin, *met)
    assert same(step.end, end, *met)
    assert not step.rows[degree + 1 :].any()
    if degree == 3:
        assert not step.end.qdd.any()
        assert step.at(length).qdd.any()


@pytest.mark.parametrize("degree", [1, 3, 5])
def test_speeds_and_accelerations_are_derivatives(degree: int) -> None:
    rng = np.random.default_rng(degree)
    step = Step.to(random_moment(rng), random_moment(rng), 0.8, degree)
    for t in (0.1, 0.4, 0.7):
        before, here, after = step.at(t - 1e-5), step.at(t), step.at(t + 1e-5)
        assert here.qd == pytest.approx((after.q - before.q) / 2e-5, rel=1e-6, abs=1e-6)
        assert here.qdd == pytest.approx((after.qd - before.qd) / 2e-5, rel=1e-6, abs=1e-6)


def test_sampling_many_steps_equals_single_steps() -> None:
    rng = np.random.default_rng(4)
    steps = [Step(rng.uniform(-1.0, 1.0, (6, 6)), length) for length in (0.5, 1.0, 2.0)]
    sampled = _sampled(np.array([step.rows for step in steps]), np.array([step.length for step in steps]))
    for number, step in enumerate(steps):
        for place, t in enumerate(np.linspace(0.0, step.length, 17)):
            there, beside = step.at(t), [step.at(t + off).qdd for off in (0.0, 1e-6)]
            expected = (there.q, there.qd, there.qdd, (beside[1] - beside[0]) / 1e-6)
            for values, each in zip(sampled, expected, strict=True):
                np.testing.assert_allclose(values[number, place], each, rtol=1e-3, atol=1e-3)


@pytest.mark.parametrize("degree", [1, 3, 5])
def test_step_can_be_divided(degree: int) -> None:
    rng = np.random.default_rng(degree)
    step = Step.to(random_moment(rng), random_moment(rng), 0.8, degree)
    beginning, rest = step.cut(0.3), step.rest(0.3)
    assert (beginning.length, beginning.degree) == (0.3, {1: 1, 3: 4, 5: 5}[degree])
    assert rest.length == pytest.approx(0.5)
    assert rest.degree == degree
    assert same(beginning.end, step.at(0.3), "q", "qd", "qdd")
    for t in (0.0, 0.2, 0.5):
        assert same(rest.at(t), step.at(0.3 + t), "q", "qd", "qdd")


@pytest.mark.parametrize(("degree", "count"), [(1, 1), (3, 2), (4, 2), (5, 3)])
def test_begins_in_compares_only_quantities_of_its_degree(degree: int, count: int) -> None:
    rng = np.random.default_rng(degree)
    step = Step.to(random_moment(rng), random_moment(rng), 0.8, degree)
    for number, name in enumerate(("q", "qd", "qdd")):
        for joint in range(6):
            for by, is_same in ((0.9e-6, True), (-1.1e-6, False)):
                begin = step.begin
                getattr(begin, name)[joint] += by
                assert step.begins_in(begin) is (is_same or number >= count)


def test_moment_counts_as_at_rest_below_1e_6() -> None:
    for speed, acceleration, rests in ((0.9e-6, -0.9e-6, True), (-1.1e-6, 0.0, False), (0.0, 1.1e-6, False)):
        assert moment(speed, acceleration).rests is rests
    assert JointMoment.at_rest([1.0] * 6).rests


@pytest.mark.parametrize("seed", range(5))
def test_braking_begins_in_moment_and_ends_at_rest(seed: int) -> None:
    begin = random_moment(np.random.default_rng(seed), 2.0)
    step = Step.braking(begin, LIMITS)
    assert same(step.begin, begin, "q", "qd", "qdd")
    assert same(step.end, JointMoment.at_rest(step.end.q), "qd", "qdd")


# -- limits of an arm --------------------------------------------------------------------------------------

SPEED, ACCELERATION, JERK = 2.0, 8.0, 60.0


def bounds(arm: str | None = "UR5e") -> Bounds:
    own = (JointLimit(SPEED, ACCELERATION, JERK),) * 6
    return Bounds(None if arm is None else model(arm), (SPEED,) * 6, own)


def only(joint: int, value: float, q: float = 0.0, acceleration: float = 0.0) -> JointMoment:
    """Return a moment with one joint at `q` and moving."""
    here = JointMoment.at_rest([0.0] * 6)
    here.q[joint], here.qd[joint], here.qdd[joint] = q, value, acceleration
    return here


@pytest.mark.parametrize("joint", [0, 3, 5])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_first_exceeded_limit_is_reported(joint: int, sign: float) -> None:
    """The error names the step, the joint, the value and the limit."""
    still = Step.to(only(joint, 0.0), only(joint, 0.0), 1.0, 5)
    name = f"joint {joint}"
    cases = [
        (
            Step.to(only(joint, 0.0), only(joint, 0.0, sign * 2.1), 1.0, 1),
            rf"two: speed .*{name}\) is -?2\.1000 rad/s; ",
        ),
        (
            Step.to(only(joint, 0.0, 0.0, sign * 42.0), only(joint, 0.0, 0.0, sign * 42.0), 0.05, 5),
            rf"two: acceleration .*{name}\) is -?42\.0000 rad/s²; the limit of a UR5e is 40\.0000",
        ),
        (
            Step.to(only(joint, 0.0, sign * 6.2), only(joint, 0.0, sign * 6.3), 1.0, 5),
            rf"two: position of .*{name}\) is -?6\.\d+ rad; the limit of a UR5e is -?6\.2832 rad",
        ),
        (
            Step.to(only(joint, sign * 1.5, sign * 5.0), only(joint, sign * 1.5, sign * 6.2), 0.8, 5),
            rf"two: position after braking, if no point followed, of .*{name}\) is -?6\.\d+ rad",
        ),
    ]
    for step, message in cases:
        with pytest.raises(BadValue, match=message):
            bounds().check([still, step], ["one", "two"])


def test_rounding_does_not_exceed_limits() -> None:
    for excess, is_refused in ((1.0 + 0.9e-6, False), (1.0 + 1.2e-6, True)):
        step = Step.to(only(0, 0.0), only(0, 0.0, excess * SPEED), 1.0, 1)
        with pytest.raises(BadValue) if is_refused else contextlib.nullcontext():
            bounds().check([step], ["one"])


def test_acceleration_is_not_checked_between_straight_steps() -> None:
    """Speeds jump between straight steps; the program on the robot brakes there."""
    there, back = only(0, 0.0, 0.02), only(0, 0.0, 0.0)
    bounds().check([Step.to(back, there, 0.02, 1), Step.to(there, back, 0.02, 1)], ["one", "two"])
    with pytest.raises(BadValue, match="one: acceleration"):
        bounds().check([Step.to(back, there, 0.02, 3), Step.to(there, back, 0.02, 3)], ["one", "two"])


def test_error_suggests_degrees() -> None:
    with pytest.raises(BadValue, match=r"position of base .* is 45\.0000 rad; .* rad \(in degrees\?\)"):
        bounds().check([Step.to(only(0, 0.0, 45.0), only(0, 0.0, 45.0), 1.0, 5)], ["one"])


def test_unknown_arm_has_general_limits() -> None:
    """A message can hold three turns; the acceleration limit is beyond every known arm."""
    turns = 6.0 * math.pi
    unknown = bounds(None)
    for q, acceleration, message in (
        (turns - 0.01, 0.0, ""),
        (0.0, 990.0, ""),
        (turns + 0.01, 0.0, f"the limit of the fastest arm is {turns:.4f} rad"),
        (-turns - 0.01, 0.0, f"the limit of the fastest arm is -{turns:.4f} rad"),
        (0.0, 1010.0, r"the limit of the fastest arm is 1000\.0000 rad/s²"),
    ):
        here = only(2, 0.0, q, acceleration)
        step = Step.to(here, only(2, 0.0, q, acceleration), 1e-3, 5)
        with pytest.raises(BadValue, match=message) if message else contextlib.nullcontext():
            unknown.check([step], ["one"])


@pytest.mark.parametrize(
    "begin",
    [only(1, 0.0), only(1, 1.0), only(1, -1.0), only(1, 0.5, 0.0, 4.0), only(1, 0.0, 0.0, 9.0), only(1, -1.9)],
    ids=str,
)
def test_path_to_moving_target_is_quick_and_within_limits(begin: JointMoment) -> None:
    """The way takes at most an eighth longer than necessary."""
    end = only(1, 0.3, 0.5)
    way = bounds().way(begin, end, 0.004)
    assert way is not None
    assert same(way.begin, begin, "q", "qd", "qdd")
    assert same(way.end, end, "q", "qd", "qdd")
    t = np.linspace(0.0, way.length, 400)
    moments = [way.at(each) for each in t]
    assert max(abs(each.qd[1]) for each in moments) <= SPEED * 1.01
    hardest = max(ACCELERATION, abs(begin.qdd[1]))
    assert max(abs(each.qdd[1]) for each in moments) <= hardest * 1.01
    assert np.abs(np.diff([each.qdd[1] for each in moments]) / t[1]).max() <= JERK * 1.01
    quicker = [Step.to(begin, end, way.length / factor, 5) for factor in (1.126, 1.25, 1.5)]
    assert bounds().first_within(quicker) is None


def test_path_takes_the_given_time_or_at_most_20_s() -> None:
    begin, end = only(0, 0.0), only(0, 0.0, 0.01)
    for least in (3.0, 19.0, 25.0):
        way = bounds().way(begin, end, least)
        assert way is not None
        assert way.length == least
    assert bounds().way(begin, only(0, 0.0, 6.5), 0.004) is None
    assert bounds().way(begin, only(0, 2.1), 30.0) is None
    slow = Bounds(model("UR5e"), (0.1,) * 6, (JointLimit(0.1, ACCELERATION, JERK),) * 6)
    for q, is_there in ((0.9, True), (1.2, False)):  # the largest speed is 15/8 of the mean speed
        assert (slow.way(begin, only(0, 0.0, q), 0.004) is not None) is is_there


@pytest.mark.parametrize("number", [0, 1, 15, 16, 17, 31, 32])
def test_each_tried_duration_is_12_5_percent_longer(number: int) -> None:
    """The largest speed of such a step is 15/8 of its mean. The limit is 1 rad/s."""
    slow = Bounds(None, (1.0,) * 6, (JointLimit(1.0, 1e3, 1e6),) * 6)
    least = 0.1
    far = only(0, 0.0, least * 1.125 ** (number - 0.5) / 1.875)
    way = slow.way(only(0, 0.0), far, least)
    assert way is not None
    assert way.length == pytest.approx(least * 1.125**number)


@pytest.mark.parametrize(("least", "way"), [(25.0, 14.5), (19.9, 10.8)])
def test_only_given_time_may_exceed_20_s(least: float, way: float) -> None:
    slow = Bounds(None, (1.0,) * 6, (JointLimit(1.0, 1e3, 1e6),) * 6)
    begin, end = only(0, 0.0), only(0, 0.0, way)
    assert slow.way(begin, end, least) is None
    assert slow.way(begin, end, 1.125 * least) is not None


def test_rounding_does_not_exceed_limits_of_stream() -> None:
    for size, is_within in ((1.0 + 0.9e-6, True), (1.0 + 1.2e-6, False)):
        even, hard = np.zeros((6, 6)), np.zeros((6, 6))
        even[1, 0], hard[3, 0] = size * SPEED, size * JERK / 6.0
        for rows in (even, hard):
            assert (bounds().first_within([Step(rows, 0.01)]) == 0) is is_within


@pytest.mark.parametrize("joint", range(6))
def test_first_step_within_each_limit_is_found(joint: int) -> None:
    begin, far = only(joint, 0.0), only(joint, 0.0, 0.5)
    ways = [Step.to(begin, far, length, 5) for length in (0.2, 0.4, 1.2, 1.5)]
    assert bounds().first_within(ways) == 2
    assert bounds().first_within(ways[:2]) is None
    beyond = [Step.to(only(joint, 0.0, q), only(joint, 0.0, q), 1.0, 5) for q in (6.3, -6.3, 6.28)]
    assert bounds().first_within(beyond) == 2


# -- onto another curve ------------------------------------------------------------------------------------

SHORTEST = 0.004


def ramp(first: float, last: float, spacing: float = 0.1, rate: float = 0.2) -> list[Aim]:
    """Return a curve that turns the last joint steadily, from 0 at 0 s."""
    aims: list[Aim] = []
    for n in range(round((last - first) / spacing) + 1):
        time = first + n * spacing
        here = only(5, rate, rate * time)
        step = None if not aims else Step.to(aims[-1].moment, here, time - aims[-1].time, 5)
        aims.append(Aim(time, here, step))
    return aims


def check_on(curve: list[Aim], found: list[Aim], here: JointMoment, time: float) -> None:
    """Check that the path goes from `here` onto the curve, and stays on it."""
    assert found[0].step is not None
    assert same(found[0].step.begin, here, "q", "qd", "qdd")
    before = found[0].time - found[0].step.length
    assert before == pytest.approx(time)
    for aim, following in itertools.pairwise(found):
        assert following.step is not None
        assert same(following.step.begin, aim.moment, "q", "qd", "qdd")
        assert following.step.length == pytest.approx(following.time - aim.time)
    for aim in found:
        assert aim.step is not None
        assert same(aim.step.end, aim.moment, "q", "qd", "qdd")
        assert aim.moment.q[5] == pytest.approx(0.2 * aim.time)
    assert found[-1].time == curve[-1].time


@pytest.mark.parametrize(("since", "lands"), [(0.5, 1.0 + 2 * SHORTEST), (1.3, 1.3)])
def test_path_joins_curve_as_early_as_possible(since: float, lands: float) -> None:
    """Joining takes at least four cycles, and does not happen before the curve begins."""
    curve, here = ramp(since, 2.0), only(5, 0.2, 0.2)
    found = onto(bounds(), curve, here, 1.0, SHORTEST)
    assert found[0].time == pytest.approx(lands)
    check_on(curve, found, here, 1.0)
    assert [aim.time for aim in found[1:]] == pytest.approx([aim.time for aim in curve if aim.time > lands + 1e-9])
    assert all(aim.degree == 5 for aim in found)


@pytest.mark.parametrize("beside", [0.001, 0.03, 0.2])
def test_path_to_curve_is_as_slow_as_limits_require(beside: float) -> None:
    """Each attempt takes a quarter longer than the previous one."""
    curve, here = ramp(0.0, 3.0), only(5, 0.2, 0.2 + beside)
    found = onto(bounds(), curve, here, 1.0, SHORTEST)
    check_on(curve, found, here, 1.0)
    assert found[0].step is not None
    length = found[0].step.length
    assert math.log(length / (2 * SHORTEST), 1.25) == pytest.approx(round(math.log(length / (2 * SHORTEST), 1.25)))
    assert bounds().first_within([found[0].step]) == 0
    sooner = 1.0 + length / 1.25
    assert bounds().first_within([Step.to(here, only(5, 0.2, 0.2 * sooner), sooner - 1.0, 5)]) is None


def test_path_joins_curve_at_last_point_if_necessary() -> None:
    curve, here = ramp(0.0, 1.6), only(5, 0.2, 0.2 + 0.19)
    (last,) = onto(bounds(), curve, here, 1.0, SHORTEST)
    assert last.time == 1.6
    # However, it does not join at a point that it cannot reach in time.
    with pytest.raises(BadValue, match=r"up to 1\.2 s cannot be reached from the position of the stream at 1 s"):
        onto(bounds(), ramp(0.0, 1.2), here, 1.0, SHORTEST)


@pytest.mark.parametrize(
    ("ends", "is_past"), [(1.0, True), (1.0 + 1.4 * SHORTEST, True), (1.0 + 1.6 * SHORTEST, False)]
)
def test_points_in_the_past_are_rejected(ends: float, is_past: bool) -> None:
    curve, here = ramp(ends - 0.5, ends), only(5, 0.2, 0.2)
    why = rf"all points are in the past: the last is at {ends:g} s, but points are needed from 1 s on"
    with pytest.raises(BadValue, match=why) if is_past else contextlib.nullcontext():
        (found,) = onto(bounds(), curve, here, 1.0, SHORTEST)
        assert found.time == pytest.approx(ends)


@pytest.mark.parametrize(("before", "lands"), [(0.9 * SHORTEST, 1.1), (1.1 * SHORTEST, 1.1 - 1.1 * SHORTEST)])
def test_path_joins_curve_at_a_near_point(before: float, lands: float) -> None:
    """Otherwise, the rest of the step to that point would be too short."""
    time = 1.1 - before - 2 * SHORTEST
    here = only(5, 0.2, 0.2 * time)
    found = onto(bounds(), ramp(0.0, 2.0), here, time, SHORTEST)
    assert found[0].time == pytest.approx(lands)
    check_on(ramp(0.0, 2.0), found, here, time)

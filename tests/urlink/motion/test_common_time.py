"""Common time of several arms, whose controllers have different clocks."""

from __future__ import annotations

import math

import pytest

from tests.contended import contended_lock
from tests.urlink.motion.test_program_time import state
from urlink.motion.stream.common_time import CommonPace, CommonTime, MemberPace, MemberTimer

CYCLE = 0.008
#: Time in s that each controller's clock is ahead of this computer's clock
OFFSETS = (100.0, -7.0)
#: Rate of change of a rate, in 1/s
RAMP = 6.25


# -- trajectories ------------------------------------------------------------------------------------------


class Clocks:
    """Two arms; `now` is this computer's time in s, and a state arrives `late` s after its time."""

    def __init__(self, late: float = 0.0) -> None:
        self.now, self.late = 50.0, late
        self.common = CommonTime()
        self.members = [self._member(offset) for offset in OFFSETS]

    def _member(self, offset: float) -> MemberTimer:
        return self.common.member(lambda time: time - offset, CYCLE)

    def step(self, *scalings: float | None) -> None:
        """Advance by one cycle and pass a state of each arm; no state if its scaling is None."""
        self.now += CYCLE
        for member, offset, scaling in zip(self.members, OFFSETS, scalings, strict=True):
            if scaling is not None:
                member.passed(state(scaling, time=self.now - self.late + offset), self.now)

    def begin(self, *scalings: float) -> None:
        """Step until the common time has started at 0 s."""
        self.step(*scalings)
        for member in self.members:
            member.beginning()
        while self.members[0].beginning() is None:
            self.step(*scalings)

    @property
    def time(self) -> float:
        return self.common.at(self.now)


@pytest.mark.parametrize("late", [0.0, 0.02, -0.005])
def test_arms_of_a_group_start_50_ms_after_the_last_is_ready(late: float) -> None:
    clocks = Clocks(late)
    one, other = clocks.members
    for _ in range(5):
        clocks.step(1.0, 1.0)
        assert one.beginning() is None
    assert clocks.common.began is None
    assert other.beginning() is None
    clocks.step(1.0, 1.0)
    began = max(clocks.now, clocks.now - late) + 0.05
    assert clocks.common.began == pytest.approx(began)
    for _ in range(10):
        clocks.step(1.0, 1.0)
        at = clocks.now - late
        for member in clocks.members:
            if at < began:
                assert member.beginning() is None
            else:
                assert member.beginning() == pytest.approx(at - began)
    assert clocks.now - late > began


@pytest.mark.parametrize("slow", [0, 1])
def test_common_time_follows_slowest_arm(slow: int) -> None:
    clocks = Clocks()
    clocks.begin(1.0, 1.0)
    time = clocks.time
    scalings = [1.0, 1.0]
    scalings[slow] = 0.4
    rates = []
    for _ in range(20):
        clocks.step(*scalings)
        rates.append(clocks.common.rate)
    # The ramp takes twelve cycles at the mean of both rates. The second arm's state comes after the first one's.
    assert [each.rate for each in clocks.members] == pytest.approx([0.4, 0.4])
    assert rates == pytest.approx([min(max(1.0 - RAMP * CYCLE * (n - slow), 0.4), 1.0) for n in range(1, 21)])
    assert clocks.time - time == pytest.approx(CYCLE * (1.0 * slow + 0.4 * (20 - slow) + 0.5 * 0.6 * 12))
    time = clocks.time
    for _ in range(20):
        clocks.step(1.0, 1.0)
    assert clocks.common.rate == pytest.approx(1.0)
    assert clocks.time - time == pytest.approx(CYCLE * (0.4 * slow + 1.0 * (20 - slow) - 0.5 * 0.6 * 12))
    assert [each.rate for each in clocks.members] == pytest.approx([1.0, 1.0])


def test_common_time_starts_at_rate_of_slowest_arm() -> None:
    clocks = Clocks()
    clocks.begin(0.3, 0.8)
    assert clocks.common.rate == pytest.approx(0.3)


def test_silent_or_paused_arm_halts_the_group_until_it_leaves() -> None:
    clocks = Clocks()
    clocks.begin(1.0, 1.0)
    one, other = clocks.members
    assert other.own_rate(clocks.now + 0.0999) == 1.0
    assert other.own_rate(clocks.now + 0.1001) == 0.0
    for _ in range(40):
        clocks.step(1.0, None)
    assert clocks.common.rate == 0.0
    time = clocks.time
    clocks.step(1.0, None)
    assert clocks.time == time
    clocks.step(1.0, 1.0)
    clocks.step(1.0, 1.0)
    assert clocks.common.rate > 0.0
    other.is_paused = lambda: True
    assert other.own_rate(clocks.now) == 0.0
    for _ in range(20):
        clocks.step(1.0, 1.0)
    assert clocks.common.rate == 0.0
    other.leave()
    assert other.own_rate(clocks.now) == 1.0
    for _ in range(20):
        clocks.step(1.0, None)
    assert clocks.common.rate == 1.0
    one.leave()


def test_group_does_not_wait_for_an_arm_that_left_before_ready() -> None:
    clocks = Clocks()
    clocks.members[1].leave()
    clocks.begin(1.0, 0.1)
    assert clocks.common.rate == 1.0


@pytest.mark.parametrize(
    ("off", "towards"),
    [(0.0, 0.0), (0.004, 0.004 / 0.2), (-0.004, -0.004 / 0.2), (0.5, 0.1), (-0.5, -0.1)],
)
def test_late_arm_reaches_common_time_within_200_ms(off: float, towards: float) -> None:
    """The correction is at most a tenth of the arm's speed."""
    clocks = Clocks()
    clocks.begin(1.0, 1.0)
    clocks.step(1.0, 1.0)
    member = clocks.members[0]
    before = clocks.time - CYCLE - off
    assert member.after(before, CYCLE) == pytest.approx(before + CYCLE * (1.0 + towards))


def test_state_without_time_uses_clock_of_this_computer() -> None:
    clocks = Clocks()
    clocks.begin(1.0, 1.0)
    clocks.now += CYCLE
    time = clocks.time
    clocks.members[0].passed(state(1.0, time=math.nan), clocks.now)
    assert clocks.members[0].beginning() == pytest.approx(time)


def test_resumed_arm_starts_slowly() -> None:
    clocks = Clocks()
    clocks.begin(1.0, 1.0)
    clocks.members[1].restart()
    clocks.step(1.0, 1.0)
    assert clocks.members[1].own_rate(clocks.now) == 0.0
    clocks.step(1.0, 1.0)
    assert clocks.members[1].own_rate(clocks.now) == pytest.approx(RAMP * CYCLE)


def test_state_at_the_start_time_has_common_time_zero() -> None:
    clocks = Clocks()
    clocks.step(1.0, 1.0)
    one, other = clocks.members
    assert [one.beginning(), other.beginning()] == [None, None]
    clocks.step(1.0, 1.0)
    began = clocks.common.began
    assert began is not None
    one.passed(state(1.0, time=began + OFFSETS[0]), began)
    one._local = began
    assert one.beginning() == 0.0


# -- streams -----------------------------------------------------------------------------------------------


class Paces:
    """Two streams; `places` holds the position of each one, in s."""

    def __init__(self) -> None:
        self.now = 50.0
        self.common = CommonPace()
        self.members = [self._member(offset) for offset in OFFSETS]
        self.places = [0.0, 0.0]
        self.are_led, self.are_idle = [True, True], [False, False]
        self.rates = [1.0, 1.0]
        self.sent = [0.0, 0.0]
        self.has_left = [False, False]

    def _member(self, offset: float) -> MemberPace:
        return self.common.member(lambda time: time - offset, CYCLE)

    def step(self, cycles: int = 1) -> None:
        for _ in range(cycles):
            self.now += CYCLE
            for i, (member, offset) in enumerate(zip(self.members, OFFSETS, strict=True)):
                if self.has_left[i]:
                    continue
                what = {"is_led": self.are_led[i], "is_idle": self.are_idle[i]}
                self.sent[i] = member.look(self.now + offset, self.now, self.places[i], self.rates[i], **what)


def test_streams_start_50_ms_after_the_last_stream_has_points() -> None:
    paces = Paces()
    paces.are_led = [True, False]
    paces.step(20)
    assert paces.sent == [0.0, 0.0]
    paces.are_led = [True, True]
    paces.step()
    begins = paces.now + 0.05
    sent: list[tuple[float, float]] = []
    for _ in range(40):
        paces.step()
        assert paces.sent[0] == pytest.approx(paces.sent[1], abs=RAMP * CYCLE)
        sent.append((paces.now, paces.sent[1]))
    assert [pace for now, pace in sent if now < begins] == [0.0] * 6
    rising = [pace for now, pace in sent if now >= begins]
    # A change takes effect two cycles later.
    assert rising[:10] == pytest.approx([RAMP * CYCLE * n for n in range(2, 12)])
    assert paces.sent == pytest.approx([1.0, 1.0])


@pytest.mark.parametrize("slow", [0, 1])
def test_streams_follow_slowest_stream(slow: int) -> None:
    """The pace is 1 for the program on the slow arm, and a fraction on the other arm."""
    paces = Paces()
    paces.step(40)
    paces.rates = [0.8, 0.8]
    paces.rates[slow] = 0.4
    paces.step(40)
    assert paces.sent[slow] == 1.0
    assert paces.sent[1 - slow] == pytest.approx(0.5)
    assert paces.common.at(paces.now) == pytest.approx(0.4)
    paces.step()
    assert paces.common.at(paces.now + 0.01) == pytest.approx(0.4)


def test_single_stream_starts_after_same_delay() -> None:
    paces = Paces()
    paces.has_left[1] = True
    for _ in range(6):
        paces.step()
        assert paces.sent[0] == 0.0
    paces.step(3)
    assert paces.sent[0] > 0.0


def test_stream_without_points_does_not_delay_others() -> None:
    paces = Paces()
    paces.are_led, paces.are_idle = [True, False], [False, True]
    paces.step(40)
    assert paces.sent == [1.0, 0.0]
    paces.are_led, paces.are_idle = [False, False], [True, True]
    paces.step(2)
    assert paces.common.at(paces.now) == 0.0
    # Both start together again.
    paces.are_led, paces.are_idle = [True, True], [False, False]
    paces.step(2)
    assert paces.sent == [0.0, 0.0]
    paces.step(40)
    assert paces.sent == [1.0, 1.0]


def test_dry_stream_stops_all_streams_until_a_joint_restart() -> None:
    paces = Paces()
    paces.step(40)
    paces.are_led[1] = False
    paces.step(5)
    assert 0.0 < paces.sent[0] < 1.0
    paces.step(40)
    assert paces.sent == [0.0, 0.0]
    paces.are_led[1] = True
    paces.step(2)
    assert paces.sent == [0.0, 0.0]
    paces.step(40)
    assert paces.sent == [1.0, 1.0]


def test_silent_or_paused_stream_has_rate_zero() -> None:
    paces = Paces()
    paces.step(40)
    other = paces.members[1]
    assert other.own_rate(paces.now + 0.0999) == 1.0
    assert other.own_rate(paces.now + 0.1001) == 0.0
    other.is_paused = lambda: True
    assert other.own_rate(paces.now) == 0.0
    paces.step(40)
    assert paces.sent == [0.0, 0.0]
    other.leave()
    assert other.own_rate(paces.now) == 1.0
    paces.has_left[1] = True
    paces.step(40)
    assert paces.sent[0] == 1.0


@pytest.mark.parametrize("ahead", [0.0, 0.02, 0.1, 0.3])
@pytest.mark.parametrize("leader", [0, 1])
def test_leading_stream_slows_down_for_the_slower_stream(leader: int, ahead: float) -> None:
    """It stops if it is 0.2 s ahead or more; otherwise it slows down until the streams are together."""
    paces = Paces()
    paces.step(40)
    paces.places[leader] = ahead
    paces.step(2)
    assert paces.sent[leader] == pytest.approx(max(1.0 - ahead / 0.2, 0.0), abs=0.09)
    assert paces.sent[1 - leader] == pytest.approx(1.0)


def test_position_of_stream_is_extrapolated_for_at_most_0_1_s() -> None:
    """At its pace, for at most 0.1 s; a stream that passes no points stays where it is."""
    paces = Paces()
    paces.places = [3.0, 3.0]
    paces.step(40)
    member = paces.members[0]
    place = member.place_at(paces.now, 1.0)
    assert place == pytest.approx(3.0 + 2 * CYCLE)
    for later, passed in ((0.05, 0.05), (0.2, 0.1), (-0.05, -0.05), (-0.2, -0.1)):
        assert member.place_at(paces.now + later, 0.5) - place == pytest.approx(0.5 * passed)
    paces.are_led[0] = False
    paces.step()
    assert member.place_at(paces.now + 0.05, 0.5) == 3.0
    assert paces.common.lead(5.0, paces.now) == pytest.approx(2.0)


def test_state_without_time_uses_arrival_time_for_pace() -> None:
    paces = Paces()
    paces.step(40)
    member = paces.members[0]
    member.look(math.nan, paces.now + 0.01, 1.0, 1.0, is_led=True, is_idle=False)
    assert member.place_at(paces.now + 0.01, 1.0) == pytest.approx(1.0 + 2 * CYCLE)


# -- races between two threads -----------------------------------------------------------------------------


def test_trajectories_do_not_wait_for_an_arm_that_left_the_group() -> None:
    with contended_lock("Lock") as lock:
        clocks = Clocks()
    clocks.begin(1.0, 1.0)
    one, other = clocks.members
    other.is_paused = lambda: True
    lock.before = lambda: clocks.common.leave(other)
    clocks.step(1.0, None)
    assert clocks.common.rate == 1.0
    one.leave()


def test_streams_do_not_wait_for_an_arm_that_left_the_group() -> None:
    with contended_lock("Lock") as lock:
        paces = Paces()
    paces.step(40)
    one, other = paces.members
    other.is_paused = lambda: True
    paces.has_left[1] = True
    lock.before = lambda: paces.common.leave(other)
    paces.step()
    assert paces.common.at(paces.now + 100.0) == 1.0
    paces.common.leave(one)

"""Missing cycles according to the peer's clock: live counts equal the counts from columns of a recording."""

from __future__ import annotations

import itertools
import struct
from collections.abc import Sequence
from typing import cast

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from linkcore.clock import Stamp
from linkcore.streaming.receiver import Receiver
from linkcore.streaming.statistics import StreamCounters
from linkcore.wire.cycles import MissedCycles, Missing, gaps_of
from linkcore.wire.framing import PacketProtocol

_TIME = struct.Struct(">d")


def moment(frame: bytes) -> float | None:
    return _TIME.unpack(frame)[0] if frame else None


class Frames:
    """Framer that returns the frames of the test."""

    skipped = resyncs = 0
    rest = b""

    def __init__(self, frames: list[list[bytes]]) -> None:
        self._frames = iter(frames)

    def feed(self, data: bytes) -> list[bytes]:
        return next(self._frames)


class Timed:
    """Protocol whose packets contain only their time."""

    unknown = tails = 0

    def __init__(self, frames: list[list[bytes]], cycles: MissedCycles) -> None:
        self.framer = Frames(frames)
        self.cycles = cycles

    def decode(self, frame: bytes, stamp: Stamp | None = None) -> bytes:
        return frame


def counters(times: Sequence[float | None], *periods: float, cuts: int = 1) -> MissedCycles:
    """Count missing cycles and duplicates; check that the fast path of the receiver gets the same counts."""
    frames = [b"" if time is None else _TIME.pack(time) for time in times]
    chunks = [frames[at : at + cuts] for at in range(0, len(frames), cuts)]
    counter = MissedCycles(moment, periods)
    for chunk in chunks:
        counter.take(chunk)
    quick = MissedCycles(moment, periods, time=_TIME.unpack, size=_TIME.size)
    receiver = Receiver("frames", cast(PacketProtocol, Timed(chunks, quick)), StreamCounters())
    for number in range(len(chunks)):
        receiver.feed(b"", Stamp(number * 1e-3, 0.0))
    assert (quick.missing, quick.duplicates) == (counter.missing, counter.duplicates)
    np.testing.assert_equal(quick.last, counter.last)
    return counter


def counted(times: Sequence[float | None], *periods: float, cuts: int = 1) -> Missing:
    return counters(times, *periods, cuts=cuts).missing


def plainly(times: Sequence[float | None], period: float) -> tuple[int, int, float, int]:
    """Compute missing cycles, gaps, the longest gap and duplicates from the step between each two packets."""
    known = [time for time in times if time is not None]
    steps = [later - earlier for earlier, later in itertools.pairwise(known)]
    gaps = [step for step in steps if 1.5 * period < step <= 3600.0]
    missing = sum(max(round(step / period) - 1, 1) for step in gaps)
    return missing, len(gaps), max(gaps, default=0.0), steps.count(0.0)


#: Steps of a running clock, in periods. Some are too short; others are too long, so that cycles are missing.
_ONWARD = st.one_of(st.just(1.0), st.sampled_from([0.01, 0.5, 1.49, 1.51, 1.99, 3.0]), st.floats(0.01, 5.0))
#: Other steps: a duplicate packet, packets in the wrong order, a clock that was restarted or set, no time at all.
_OTHER = st.sampled_from([0.0, -1.0, -2.5, -1e5, 1e9, None])


@pytest.mark.property
@given(
    st.one_of(st.lists(_ONWARD, max_size=40), st.lists(st.one_of(_ONWARD, _OTHER), max_size=40)),
    st.sampled_from([0.002, 0.008]),
    st.integers(1, 12),
)
@example([1.0, 0.01, 1.99, 1.0], 0.002, 4)  # the total time of the packets is correct, but one step is too long
@example([1.99, 0.01, 1.0, 1.0], 0.002, 4)
@example([1.0, 0.0, 2.0, 1.0], 0.002, 4)
@example([2.0, -1.0, 2.0, 1.0], 0.002, 4)
@example([1.0, -1e5, 1.0, 1.0], 0.002, 4)
@example([1.0, None, 2.0, 1.0], 0.002, 4)
def test_missed_counts_do_not_depend_on_batch_size(steps: list[float | None], period: float, cuts: int) -> None:
    # The packets of the first batch are consecutive, so the first step begins with the second batch.
    times: list[float | None] = [10.0 + number * period for number in range(cuts)]
    now = 10.0 + (cuts - 1) * period
    for step in steps:
        now += (step or 0.0) * period
        times.append(None if step is None else now)
    found = counters(times, period, cuts=cuts)
    assert (*found.missing, found.duplicates) == plainly(times, period)


def test_packet_without_gap_calls_no_function_of_missed_cycles(monkeypatch: pytest.MonkeyPatch) -> None:
    cycles = MissedCycles(moment, (0.002,), time=_TIME.unpack, size=_TIME.size)
    chunks = [[_TIME.pack(number * 0.002)] for number in (1, 2, 3, 4, 9, 10)]
    receiver = Receiver("frames", cast(PacketProtocol, Timed(chunks, cycles)), StreamCounters())
    asked: list[Sequence[bytes]] = []
    take = cycles.take

    def seen(frames: Sequence[bytes]) -> None:
        asked.append(frames)
        take(frames)

    monkeypatch.setattr(cycles, "take", seen)
    for number in range(len(chunks)):
        receiver.feed(b"", Stamp(number * 1e-3, 0.0))
    assert asked == [chunks[0], chunks[4]]
    assert cycles.missing.cycles == 4


@pytest.mark.property
@given(
    st.lists(st.integers(0, 40), min_size=1, max_size=60),
    st.sampled_from([0.002, 0.008, 0.04, 0.1]),
    st.floats(0, 1e6),
    st.integers(1, 7),
    st.lists(st.integers(1, 3), min_size=61, max_size=61),
)
def test_received_and_missing_add_up_to_all_cycles(
    missing: list[int], period: float, start: float, cuts: int, copies: list[int]
) -> None:
    cycles = np.concatenate([[0], np.cumsum([each + 1 for each in missing])])
    times = start + cycles * period
    found = counters(np.repeat(times, copies[: len(times)]).tolist(), period, cuts=cuts)
    live = found.missing
    assert found.duplicates == sum(copies[: len(times)]) - len(times)
    assert live.cycles == cycles[-1] + 1 - len(times) == sum(missing)
    gaps = gaps_of(times, times, (period,))
    assert [gap.cycles for gap in gaps] == [each for each in missing if each]
    assert live.gaps == len(gaps)
    assert live.longest == max((gap.seconds for gap in gaps), default=0.0)


@pytest.mark.parametrize(("step", "period"), [(0.002, 0.002), (0.008, 0.008)])
def test_cycle_period_is_chosen_from_two_candidates(step: float, period: float) -> None:
    times = [number * step for number in range(20) if number not in (7, 8, 15)]
    assert counted(list(times), 0.002, 0.008) == pytest.approx((3, 2, 3 * step))
    found = gaps_of(np.array(times), np.array(times), (0.002, 0.008))
    assert [gap.cycles for gap in found] == [2, 1]
    assert [(gap.start, gap.end) for gap in found] == [(times[6], times[7]), (times[12], times[13])]


def test_late_state_is_not_counted_as_missing() -> None:
    """If the period is 12.5 cycles of 8 ms, robot states arrive after 12 or 13 cycles."""
    assert counted([0.0, 0.096, 0.2, 0.304, 0.4], 0.1) == Missing()
    assert counted([0.0, 0.104, 0.296, 0.4], 0.1).cycles == 1


def test_duplicates_do_not_cancel_missing_cycles_in_one_chunk() -> None:
    found = counters([0.0, 0.002, 0.002, 0.006, 0.008], 0.002, cuts=5)
    assert (found.duplicates, found.missing.cycles) == (1, 1)


def test_duplicates_of_past_connections_stay_counted() -> None:
    stream = StreamCounters()
    for connections in (1, 2):
        cycles = MissedCycles(moment, (0.002,))
        cycles.take([_TIME.pack(0.0)] * 3)
        stream.connected(cast(PacketProtocol, Timed([], cycles)), 0.0)
        assert stream.statistics.duplicates == 2 * connections
        stream.disconnected()
    assert stream.statistics.duplicates == 4


def test_restarted_clock_does_not_count_as_missed_cycles() -> None:
    """If the clock was restarted or has jumped, the number of missing cycles is unknown."""
    assert counted([100.0, 100.002, 0.0, 0.002, 0.004], 0.002) == Missing()
    assert counted([0.0, 5000.0, 5000.002, float("inf"), 1.0, float("nan"), 1.002], 0.002) == Missing()
    assert gaps_of(np.array([1.0, 1.002, 0.0, 0.002, 9000.0]), np.arange(5.0), (0.002,)) == []


def test_packets_without_time_are_skipped() -> None:
    assert counted([-0.002, None, 0.0, None, None, 0.006], 0.002) == Missing(2, 1, 0.006)


def test_no_cycle_is_missing_between_connections() -> None:
    times = np.array([0.0, 0.002, 0.4, 0.402, 0.5])
    assert [gap.cycles for gap in gaps_of(times, times, (0.002,), begins=[2])] == [48]


def test_missing_cycles_are_described_in_a_sentence() -> None:
    assert Missing(363, 2, 0.4).text(112) == "363 of 475 cycles are missing (2 gaps, the longest 0.400 s)"
    assert Missing(1, 1, 0.004).text(9) == "1 of 10 cycles is missing (1 gap, the longest 0.004 s)"

"""Feed of a stream: planning ahead, order of messages, and points that are abandoned."""

from __future__ import annotations

import contextlib
import struct
from concurrent.futures import Future
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from linkcore.errors import BadValue, Cancelled, ConnectionLost, LinkTimeout
from linkcore.pending_call import PendingCall
from tests.fakes.rehearsal import HOME, turned
from tests.urlink.motion.streamed import ACCELERATION, JERK, Report, Streamed
from tests.urlink.motion.test_stream import E_SERIES, FIRMWARES, wave, waves
from urlink.errors import ToleranceExceeded
from urlink.motion.moves.trajectory import TrajectoryPoint
from urlink.motion.stream.common_time import MemberPace
from urlink.motion.stream.program_pace import ProgramPace
from urlink.motion.stream.stream_feed import StreamFeed
from urlink.motion.stream.stream_steps import Handed, Mark, Step
from urlink.protocol.firmware import Firmware
from urlink.protocol.realtime.packets import RealtimeState
from urlink.script.buffering import BRAKING, CUT, FINE, MESSAGE, PACING, POINT, RESTING, PointRegisters
from urlink.script.links import SCALE, STOP, WAIT, ReverseSocket

STILL = [0.0] * 6


def reported(stream: Streamed) -> Report:
    """Run until the program has reported in this cycle, and return its report."""
    stream.until(lambda last=stream.report: stream.report is not last)
    return stream.report


def moves(stream: Streamed, since: float = 0.5) -> Streamed:
    """Append points for two more seconds, and run until `since`."""
    stream.append(waves(0.05, since + 2.0))
    stream.until(lambda: stream.feed.time > since)
    return stream


def mark(stream: Streamed) -> Mark:
    """Return the mark where the next point begins."""
    assert stream.feed.mark is not None
    return stream.feed.mark


def test_feed_has_no_points_before_start_and_at_rest() -> None:
    stream = Streamed(E_SERIES)
    feed = stream.feed
    assert (feed.time, feed.reach(1.0), feed.ahead, feed.is_dry, feed.is_answered) == (0.0, 0.0, 0.0, True, True)
    assert feed.dry().done()
    assert feed.answered().done()
    feed.skip(2.0)
    feed.skip(1.0)  # does not go back
    assert feed.time == feed.reach(1.0) == mark(stream).time == 2.0
    assert mark(stream).moment.q == pytest.approx(HOME)
    stream.append(TrajectoryPoint(turned(0.1), 3.0, [0] * 6, [0] * 6))
    feed.skip(5.0)  # has no effect while points are left
    assert (feed.time, mark(stream).time) == (2.0, 3.0)
    dry, answered = feed.dry(), feed.answered()
    assert (dry.done(), answered.done(), feed.is_dry) == (False, True, False)
    stream.run(3)
    feed.skip(5.0)
    assert feed.time < 3.0
    stream.until(dry.done)
    assert feed.time == 3.0
    assert stream.path[-1] == pytest.approx(turned(0.1), abs=1e-6)
    feed.skip(5.0)
    assert feed.time == 5.0


def test_feed_is_empty_before_arm_is_at_rest() -> None:
    feed = StreamFeed(lambda link: [], contextlib.nullcontext(), Streamed(E_SERIES).bounds, 0.002, 10, 0.3)
    feed.skip(2.0)
    assert (feed.time, feed.mark, feed.begun.done()) == (0.0, None, False)


def messages_of(stream: Streamed) -> list[tuple[int, ...]]:
    """Return a list that collects the messages sent from now on, as numbers."""
    found: list[tuple[int, ...]] = []
    step = stream.feed.step

    def watched(received: bytes, state: RealtimeState, now: float) -> bytes:
        message = step(received, state, now)
        found.append(struct.unpack(f">{MESSAGE}i", message))
        return message

    stream.feed.step = watched  # type: ignore[method-assign]
    return found


def position_in(message: tuple[int, ...]) -> list[float]:
    """Return the joint positions in a message, in rad."""
    return [each / FINE for each in message[5:11]]


def angles_of_points(stream: Streamed) -> list[float]:
    """Return how far wrist 3 is turned at each point that was sent, in rad."""
    return [position_in(message)[5] - HOME[5] for message in stream.sent if message[0] == POINT]


def test_points_may_come_before_first_report() -> None:
    """A message opens the first epoch at point 0, where the arm rests; message numbers start at 1."""
    stream = Streamed(E_SERIES, way=10)
    messages = messages_of(stream)
    stream.run()
    assert messages == [(WAIT, 0, SCALE, *[0] * (MESSAGE - 3))]
    stream.append(waves(0.05, 0.5))
    stream.run()
    assert messages[-1][:3] == (CUT, 1, 0)
    stream.run()
    assert messages[-1][:3] == (POINT, 1, 2)
    stream.until(lambda: stream.feed.is_answered)
    assert stream.report[:2] == (5, 1)
    stream.run_dry()
    assert stream.path[-1] == pytest.approx(wave(0.5).q, abs=2e-2)


def test_end_message_of_a_stream_contains_only_a_stop() -> None:
    """The program does not end on its own."""
    assert struct.unpack(f">{MESSAGE}i", StreamFeed.farewell) == (STOP, *[0] * (MESSAGE - 1))
    assert not StreamFeed.survives_its_program


def test_pace_reaches_program_after_three_cycles() -> None:
    """This is the delay of a message that answers a state, and of the state that shows the change."""
    pace = ProgramPace()
    found: list[float] = []
    for cycle in range(1, 7):
        pace.passed(RESTING, 0.002)
        pace.want(1.0 - 0.125 * cycle)
        found.append(pace.now)
    assert found == [1.0, 1.0, 1.0, 0.875, 0.75, 0.625]


def test_pace_returns_to_one_while_braking() -> None:
    pace = ProgramPace()
    for _ in range(4):
        pace.want(0.5)
        pace.passed(RESTING, 0.002)
    assert pace.now == 0.5
    pace.passed(BRAKING, 0.006)
    assert pace.now == pytest.approx(0.5 + 0.006 * PACING)
    pace.passed(BRAKING, 0.5)
    assert pace.now == 1.0


def test_pace_changes_at_rate_of_program() -> None:
    """This holds while the arm moves."""
    stream, paces = Streamed(E_SERIES), Paces()
    stream.feed.pace = cast(MemberPace, paces)
    stream.append(waves(0.05, 0.6))
    stream.until(lambda: stream.feed.time > 0.3)
    messages, found, change = messages_of(stream), [], PACING * stream.period
    paces.wanted = 0.5
    for _ in range(5):
        time = stream.feed.time
        stream.run()
        found.append((stream.feed.time - time) / stream.period)
    assert (WAIT, 0, SCALE // 2, *[0] * (MESSAGE - 3)) in messages
    assert found == pytest.approx([1.0, 1.0, 1.0, 1.0 - change, 1.0 - 2.0 * change], abs=2e-3)


def test_stream_time_without_reports_stops_at_last_sent_point() -> None:
    stream = moves(Streamed(E_SERIES))
    stream.way = 10_000
    before = stream.feed.time
    stream.run(50)
    assert stream.feed.time == pytest.approx(before + 50 * stream.period)
    stream.run(1000)
    assert stream.feed.time == stream.feed.reach(100.0) == mark(stream).time


@pytest.mark.parametrize("is_lossy", [False, True])
def test_cut_is_repeated_if_messages_may_be_lost(is_lossy: bool) -> None:
    stream = Streamed(E_SERIES, way=5)
    stream.feed.body(PointRegisters(24, 30, 30, 7) if is_lossy else ReverseSocket("10.0.0.1", 50001, 7))
    messages = messages_of(stream)
    stream.append(waves(0.05, 0.5))
    stream.run(9)
    kinds = [what for what, *_ in messages]
    assert kinds.count(CUT) == (9 if is_lossy else 1)


@pytest.mark.parametrize(("cycles", "old", "counts"), [(0, 1, True), (2, 3, False), (2, 4, True), (10, 11, False)])
def test_old_report_does_not_count_after_time_without_states(cycles: int, old: int, counts: bool) -> None:
    """After three or more cycles, a report may be older than the state that comes with it, by up to their time."""
    stream = moves(Streamed(E_SERIES))
    report, before = reported(stream), stream.feed.time
    stream.bench.cycle += cycles
    passed = report.passed + round((cycles + 1 - old + 0.01) * stream.period * SCALE)
    stream.receive(report._replace(passed=passed))
    wanted = cycles + 1.01 - old if counts else cycles + 1
    assert (stream.feed.time - before) / stream.period == pytest.approx(wanted, abs=2e-3)


def test_forgetting_unknown_points_does_not_change_the_end() -> None:
    stream = moves(Streamed(E_SERIES))
    stream.feed.replace(0.67, ())
    end = mark(stream)
    stream.feed.forget(Handed())
    assert mark(stream) is end


def test_feed_is_answered_when_all_replacements_are_answered() -> None:
    stream = moves(Streamed(E_SERIES, way=5))
    feed = stream.feed
    curve = stream.reader.curve(waves(0.4, 2.5), 0.4, mark(stream))
    done = [feed.replace(0.4, curve) for _ in range(2)]
    answered = feed.answered()
    while not answered.done():
        assert not feed.is_answered
        stream.run()
    assert feed.is_answered
    assert [each.done() for each in done] == [True, True]
    assert done[0].result() < done[1].result()


def test_check_rejects_impossible_replacement_in_advance() -> None:
    stream = moves(Streamed(E_SERIES))
    curve = stream.reader.curve([TrajectoryPoint(turned(2.0), 0.7, [0] * 6)], 0.4, mark(stream))
    before, sent = mark(stream), stream.feed.reach(100.0)
    with pytest.raises(BadValue, match="cannot be reached"):
        stream.feed.check(0.4, curve)
    stream.feed.check(0.4, stream.reader.curve(waves(0.4, 1.85), 0.4, before))
    assert mark(stream) is before
    assert stream.feed.is_answered
    assert stream.feed.reach(100.0) == sent


@pytest.mark.parametrize("firmware", FIRMWARES, ids=str)
def test_cut_takes_effect_six_cycles_and_10_ms_later(firmware: Firmware) -> None:
    stream = moves(Streamed(firmware))
    for later in (0.0, 0.1):
        ahead = stream.feed.reach(later) - stream.feed.time
        assert ahead == pytest.approx(6 * stream.period + 0.01 + later, abs=1e-9)


def test_cut_takes_effect_at_most_a_second_later() -> None:
    stream = moves(Streamed(E_SERIES, buffer=3.0, way=400))
    stream.feed.margin = 0.6  # messages take 0.8 s
    assert stream.replace(0.0, waves(0.05, 6.0)) > 1.0
    assert stream.feed.margin == 1.0


@pytest.mark.parametrize("way", [0, 60])
def test_program_receives_no_more_points_than_capacity(way: int) -> None:
    """One slot is for the beginning of a step that is cut. On a slow connection, reports are late."""
    stream = Streamed(E_SERIES, buffer=0.1, way=way)
    feed = stream.feed
    feed.add(stream.reader.after(waves(0.004, 1.0, 0.004), mark(stream)), Handed())
    held: list[int] = []
    messages = messages_of(stream)
    for _ in range(300):
        stream.run()
        if messages[-1][0] == POINT:
            held.append(messages[-1][2] - stream.report.base)
    assert max(held) == stream.capacity - 1 == 28


def test_append_future_is_done_when_last_point_was_sent() -> None:
    stream = Streamed(E_SERIES, buffer=0.3)
    feed = stream.feed
    one, two = stream.append(waves(0.05, 0.2)), stream.append(waves(0.25, 0.7))
    stream.until(one.future.done)
    assert feed.reach(100.0) == pytest.approx(0.2)
    assert not two.future.done()
    stream.run(30)
    assert 0.28 < feed.ahead < 0.35
    assert not two.future.done()
    stream.until(two.future.done)
    assert feed.reach(100.0) == pytest.approx(0.7)
    assert feed.time == pytest.approx(0.65 - 0.3, abs=0.005)  # the second-to-last point is 0.3 s away


@pytest.mark.parametrize("cycles", [0, 1, 2, 3, 30])
def test_stream_time_is_correct_after_the_computer_was_frozen(cycles: int) -> None:
    """The first reports after that are older than the state."""
    stream = moves(Streamed(E_SERIES, way=3), 0.3)
    for _ in range(20):
        stream.run(7)
        before, begin = stream.feed.time, stream.bench.cycle
        stream.run(cycles, is_frozen=True)
        stream.run()
        assert stream.feed.time - before == pytest.approx((stream.bench.cycle - begin) * stream.period)


def test_end_is_reported_to_all_waiting_calls() -> None:
    stream = moves(Streamed(E_SERIES, way=5))
    feed = stream.feed
    replaced, others = [feed.replace(0.0, ()) for _ in range(2)], [feed.answered(), feed.dry()]
    handed = stream.append(TrajectoryPoint(mark(stream).moment.q, 3.0))
    error = ConnectionLost("stream lost")
    feed.end(error)
    assert handed.future.exception(0.0) is error
    assert [each.exception(0.0) for each in replaced] == [error] * 2
    assert [each.exception(0.0) for each in others] == [error] * 2
    assert feed.begun.result() is None  # it had already begun
    feed.end(LinkTimeout("later"))
    assert replaced[0].exception() is error


def test_feed_does_not_start_after_end() -> None:
    """Another thread has ended the feed since this thread checked it."""
    stream = Streamed(E_SERIES)
    feed = StreamFeed(lambda link: [], contextlib.nullcontext(), stream.bounds, 0.002, 10, 0.3)
    feed.end(ConnectionLost("stream lost"))
    for cycle in range(3):
        message = feed.step(b"", stream.state(), 1000.0 + 0.002 * cycle)
        assert message[:4] == WAIT.to_bytes(4, "big")
    assert feed.mark is None


def test_end_before_start_is_reported() -> None:
    feed = StreamFeed(lambda link: [], contextlib.nullcontext(), Streamed(E_SERIES).bounds, 0.002, 10, 0.3)
    error = ConnectionLost("stream lost")
    feed.end(error)
    assert feed.begun.exception(0.0) is error


# -- replaced ----------------------------------------------------------------------------------------------


def is_consistent(stream: Streamed) -> bool:
    """Whether the sent points that are still ahead match the clock of the stream: the arm is on its points."""
    return bool(stream.feed.ahead == pytest.approx(stream.feed.reach(100.0) - stream.feed.time, abs=1e-9))


def is_chained(stream: Streamed) -> bool:
    """Whether each sent step has the next number, and the time that is left is the time of their lengths."""
    lengths: list[int] = []
    for what, _, number, length, *_ in stream.sent:
        if what == CUT:  # its end is the next point
            lengths[number:] = [length]
        elif what == POINT:
            if number != len(lengths) + 1:
                return False
            lengths.append(length)
    since = stream.since_report * stream.period
    left = (sum(lengths[stream.report.base :]) - stream.report.passed) / SCALE - since
    return bool(stream.feed.ahead == pytest.approx(left, abs=1e-5))


@pytest.mark.parametrize("since", [0.0, 0.62, 1.2, 1.22])
def test_unsent_points_are_cancelled_by_replacement(since: float) -> None:
    stream = Streamed(E_SERIES)
    one, two = stream.append(waves(0.05, 0.6)), stream.append(waves(0.65, 2.0))
    stream.until(lambda: stream.feed.time > 0.4)
    assert one.future.done()
    assert is_consistent(stream)
    chunk = waves(since + 0.3, 2.5)
    assert stream.replace(since, chunk) >= since
    assert mark(stream).time == chunk[-1].time
    assert mark(stream).moment.q == pytest.approx(chunk[-1].q)
    assert one.future.exception() is None
    # Points before the new ones are still sent.
    assert two.future.done() is (since < 0.65)
    if since < 0.65:
        with pytest.raises(Cancelled, match="were replaced or cleared before the robot had room"):
            two.future.result()
    for _ in range(100 + round(since / stream.period)):
        stream.run()
        assert is_consistent(stream)
        assert is_chained(stream)
    stream.until(lambda: stream.feed.time >= since)
    assert stream.path[-1] == pytest.approx(wave(stream.feed.time).q, abs=3e-3)
    stream.until(lambda: stream.feed.time > 2.4)
    assert stream.path[-1] == pytest.approx(wave(stream.feed.time).q, abs=3e-3)
    assert two.future.done()
    assert stream.feed.starved == 0


def test_tail_is_cut_at_given_time() -> None:
    stream = moves(Streamed(E_SERIES))
    cleared = stream.feed.replace(0.67, ())
    assert mark(stream).time == 0.67
    assert stream.feed.reach(100.0) == pytest.approx(0.67)
    # The points before that time stay.
    stream.feed.forget(stream.append(TrajectoryPoint(mark(stream).moment.q, 1.5)))
    assert mark(stream).time == pytest.approx(0.67)
    assert mark(stream).moment.q == pytest.approx(wave(0.67).q, abs=2e-6)
    stream.until(cleared.done)
    assert is_consistent(stream)
    stream.run_dry()
    assert stream.feed.time == pytest.approx(0.67)


@pytest.mark.parametrize("cycles", [1, 5, 20, 80])
def test_points_are_replaced_right_after_resuming_from_braking(cycles: int) -> None:
    """The cut is in the rest of the braking, in the path from there, or later."""
    stream = Streamed(E_SERIES)
    stream.append(waves(0.05, 0.6))
    stream.until(lambda: stream.report.phase == BRAKING)
    begin, end = len(stream.path), mark(stream)
    there = end.moment.q + 0.1
    stream.append([TrajectoryPoint(there, end.time + t, [0] * 6, [0] * 6) for t in (0.5, 0.7)])
    stream.until(lambda: stream.report.phase != BRAKING)
    assert is_chained(stream)
    stream.run(cycles)
    assert is_chained(stream)
    assert is_consistent(stream) is (cycles >= 20)
    still = [TrajectoryPoint(there - 0.03, end.time + 0.1 * i, [0] * 6, [0] * 6) for i in range(3, 14)]
    stream.replace(0.0, still)
    stream.run_dry()
    assert stream.path[-1] == pytest.approx(there - 0.03, abs=1e-6)
    assert stream.feed.starved == 1
    _, qdd, qddd = stream.derivatives(begin - 5)
    assert np.abs(qdd).max() < ACCELERATION
    assert np.abs(qddd).max() < JERK * 1.05


def test_first_points_of_a_stream_are_all_queued() -> None:
    stream = Streamed(E_SERIES)
    stream.append([TrajectoryPoint(turned(angle), t) for angle, t in ((0.05, 0.05), (0.0, 2.0))])
    stream.run_dry()
    assert angles_of_points(stream) == pytest.approx([0.05, 0.0], abs=1e-6)


def test_replacement_may_start_at_end_of_sent_points() -> None:
    stream = moves(Streamed(E_SERIES))
    end = stream.feed.reach(100.0)
    assert end < mark(stream).time
    assert stream.replace(end, waves(end + 0.3, 2.5)) == end
    stream.until(lambda: stream.feed.time > 2.4)
    assert stream.path[-1] == pytest.approx(wave(stream.feed.time).q, abs=3e-3)


def test_replacing_with_same_points_takes_four_cycles() -> None:
    """A step takes at least two cycles, and the first step takes twice that."""
    stream = moves(Streamed(E_SERIES))
    curve = stream.reader.curve(waves(0.05, 2.5), 0.0, mark(stream))
    stream.feed.replace(0.0, curve)
    messages = messages_of(stream)
    stream.run(2)
    assert [message[0] for message in messages] == [CUT, POINT]
    assert messages[1][3] == pytest.approx(4 * stream.period * SCALE, abs=1)


def test_points_at_the_current_time_are_skipped_at_rest() -> None:
    stream = Streamed(E_SERIES)
    with pytest.raises(BadValue, match="all points are in the past: the last is at 0 s, but the stream is at 0 s"):
        stream.replace(0.0, [TrajectoryPoint(HOME, 0.0, [0] * 6)])
    stream.replace(0.0, [TrajectoryPoint(turned(0.1 * t), t, [0] * 6) for t in (0.0, 0.5, 1.0)])
    stream.run_dry()
    assert angles_of_points(stream) == pytest.approx([0.05, 0.1], abs=1e-6)


@pytest.mark.parametrize(("acceleration", "lands"), [(0.3, 0.3), (1000.0, 0.0)])
def test_acceleration_at_landing_respects_limits(acceleration: float, lands: float) -> None:
    stream = Streamed(E_SERIES)
    stream.replace(0.0, [TrajectoryPoint(turned(0.05), 0.5, STILL, [*STILL[:5], acceleration])])
    messages = messages_of(stream)
    stream.run(2)
    assert [what for what, *_ in messages] == [CUT, POINT]
    assert messages[-1][-1] == pytest.approx(lands * SCALE, abs=1)
    stream.run_dry()


def test_replacement_at_rest_skips_unreachable_points() -> None:
    stream = Streamed(E_SERIES)
    stream.replace(0.0, [TrajectoryPoint(turned(0.01 * i), 0.05 * i, [0, 0, 0, 0, 0, 0.2]) for i in range(20)])
    stream.run(30)
    begin = stream.feed.time
    stream.run(100)
    assert stream.feed.time - begin == pytest.approx(100 * stream.period)
    assert stream.path[-1] == pytest.approx(turned(0.2 * stream.feed.time), abs=1e-3)
    # Later points must not be left out.
    stream.run_dry()
    end = mark(stream)
    stream.append([TrajectoryPoint(end.moment.q + by, end.time + t) for by, t in ((0.05, 0.05), (0.0, 2.0))])
    stream.until(lambda: stream.feed.time > end.time + 0.05)
    assert stream.path[-1] == pytest.approx(end.moment.q + 0.05, abs=5e-3)


# -- messages that come too late ---------------------------------------------------------------------------


@pytest.mark.parametrize(("buffer", "cycles", "starved"), [(0.1, 20, 0), (0.1, 100, 1), (0.3, 100, 0), (0.3, 200, 1)])
def test_points_that_arrived_too_late_are_sent_again(buffer: float, cycles: int, starved: int) -> None:
    """The network is blocked in both directions, partly for longer than the program holds points."""
    stream = moves(Streamed(E_SERIES, buffer=buffer), 0.5)
    begin = len(stream.path)
    stream.way = cycles
    stream.run(cycles)
    stream.way = 0
    stream.until(lambda: stream.feed.time > 2.4)
    assert stream.feed.starved == starved
    # No point is left out: the arm is on the wave.
    assert stream.path[-1] == pytest.approx(wave(stream.feed.time).q, abs=3e-3)
    _, qdd, _ = stream.derivatives(begin)
    assert np.abs(qdd).max() < ACCELERATION


def cutting(stream: Streamed) -> tuple[Future[float], int]:
    """Send a cut without an answer; return its future and the number of its message."""
    done = stream.feed.replace(0.65, stream.reader.curve(waves(0.65, 2.5), 0.65, mark(stream)))
    stream.run()
    assert stream.sent[-1][0] == CUT
    return done, len(stream.sent)


def test_cut_is_answered_by_first_report_after_message() -> None:
    stream = moves(Streamed(E_SERIES, way=30))
    done, number = cutting(stream)
    report = stream.report._replace(epoch=stream.sent[-1][1])
    stream.receive(report._replace(messages=number - 1))
    assert not done.done()
    stream.receive(report._replace(messages=number))
    assert done.result(0.0) == pytest.approx(0.65)


def test_time_margin_is_doubled_after_a_late_cut() -> None:
    stream = moves(Streamed(E_SERIES, way=30))
    margin = stream.feed.margin
    done, number = cutting(stream)
    stream.receive(stream.report._replace(messages=number))
    assert stream.feed.margin == 2.0 * margin
    assert [(what, epoch) for what, epoch, *_ in stream.sent[-2:]] == [(CUT, 2), (CUT, 3)]  # it is requested again
    assert not done.done()
    assert not stream.feed.is_answered


@pytest.mark.parametrize("count", [1, 2])
def test_points_in_late_messages_are_sent_again(count: int) -> None:
    stream = moves(Streamed(E_SERIES))
    report = reported(stream)
    refused = [(number, sent) for number, sent in enumerate(stream.sent, 1) if sent[0] == POINT][-count:]
    report, end = report._replace(head=refused[0][1][2] - 1), stream.feed.reach(100.0)
    stream.receive(report._replace(messages=refused[0][0] - 1))
    assert stream.feed.reach(100.0) == end
    assert stream.sent[-1][0] == WAIT
    stream.receive(report._replace(messages=refused[-1][0]))
    stream.run(count - 1)
    assert stream.sent[-count:] == [sent for _, sent in refused]
    assert stream.feed.reach(100.0) == end


def test_report_of_the_robot_corrects_the_stream_time() -> None:
    stream = moves(Streamed(E_SERIES))
    before, begin = stream.feed.time, stream.bench.cycle
    stream.receive(stream.report._replace(passed=stream.report.passed + 50_000))
    assert stream.feed.time > before + 0.005
    stream.run(20)
    assert stream.feed.time == pytest.approx(before + (stream.bench.cycle - begin) * stream.period)


@pytest.mark.parametrize("way", [0, 5, 10, 15, 30])
def test_points_arriving_while_braking_are_reached(way: int) -> None:
    """The stream continues from the braking if the cut comes in time, otherwise from rest."""
    stream = Streamed(E_SERIES, way=way)
    stream.append(waves(0.05, 0.6))
    margin = stream.feed.margin
    stream.until(lambda: stream.report.phase == BRAKING)
    assert stream.feed.time == pytest.approx(0.6)
    begin, end = len(stream.path), mark(stream)
    there = end.moment.q + 0.1
    stream.append([TrajectoryPoint(there, end.time + t, [0] * 6, [0] * 6) for t in (0.5, 0.7)])
    stream.run_dry()
    assert stream.feed.time == pytest.approx(1.3)
    assert stream.feed.starved == 1
    assert stream.path[-1] == pytest.approx(there, abs=1e-6)
    assert (stream.feed.margin > margin) is bool(way)
    qd, qdd, qddd = stream.derivatives(begin - 5)
    assert np.abs(qdd).max() < ACCELERATION
    assert np.abs(qddd).max() < JERK * 1.05
    slowest = float(np.linalg.norm(qd[: round(0.4 / stream.period)], axis=1).min())
    assert (slowest > 0.01) is (way < 10)


@pytest.mark.parametrize(("cycles", "goes_on"), [(1.5, True), (0.5, False), (-0.5, False)])
def test_stream_resumes_from_rest_if_cut_would_be_late(cycles: float, goes_on: bool) -> None:
    stream = Streamed(E_SERIES)
    feed = stream.feed
    stream.append(waves(0.05, 0.6))
    stream.until(lambda: stream.report.phase == BRAKING)
    left = Step.braking(mark(stream).moment, stream.bounds.limits).length - stream.report.passed / SCALE
    feed.margin = left - (cycles + 1.0) * stream.period  # the append takes effect in the next cycle
    stream.append(TrajectoryPoint(mark(stream).moment.q + 0.1, 2.0))
    stream.run()
    assert feed.is_answered is not goes_on


def test_cleared_stream_starves_only_after_new_points() -> None:
    stream = moves(Streamed(E_SERIES))
    stream.clear()
    stream.run_dry()
    assert stream.feed.starved == 0
    end = mark(stream)
    there = TrajectoryPoint(end.moment.q + 0.1, end.time + 1.0, [0.2] * 6)
    stream.append(there)
    stream.run_dry()
    assert stream.feed.starved == 1


@pytest.mark.parametrize("way", [5, 9, 10, 11, 20])
def test_stream_stops_at_most_once_after_braking_for_any_delay(way: int) -> None:
    """This holds even if the cut comes in time, but the first point, a cycle later, does not."""
    stream = Streamed(E_SERIES, way=way)
    stream.append(waves(0.05, 0.6))
    slowest: list[float] = []
    for _ in range(3):
        stream.until(lambda: stream.report.phase == BRAKING)
        begin, end = len(stream.path), mark(stream)
        there = end.moment.q + np.array([*STILL[:5], 0.2])
        stream.append(TrajectoryPoint(there, end.time + 0.5, [*STILL[:5], 0.4], STILL))
        stream.until(lambda end=end: stream.feed.time > end.time + 0.3)
        slowest.append(float(np.linalg.norm(stream.derivatives(begin - 5)[0], axis=1).min()))
    assert min(slowest[1:]) > 0.04
    assert stream.feed.starved == 3


def test_clear_while_resuming_counts_no_late_point() -> None:
    stream = Streamed(E_SERIES)
    stream.append(waves(0.05, 0.6))
    stream.until(lambda: stream.report.phase == BRAKING)
    end = mark(stream)
    stream.append(TrajectoryPoint(end.moment.q + 0.1, end.time + 1.0, STILL, STILL))
    stream.until(lambda: stream.report.phase != BRAKING)
    stream.feed.margin = 0.006  # within the rest of the braking
    stream.clear()
    stream.run_dry()
    resumed, cleared = [message[2] for message in stream.sent if message[0] == CUT][-2:]
    assert resumed == cleared  # both cut the braking
    assert (stream.feed.margin, stream.feed.starved) == (0.006, 1)


# -- pauses ------------------------------------------------------------------------------------------------


def paused(stream: Streamed, q: Any = None) -> int:
    """Resume after a pause, at the current position or at `q`; return the number of messages sent before."""
    state = stream.state()
    stream.feed.resume(state if q is None else cast(RealtimeState, SimpleNamespace(q_target=np.array(q))))
    return len(stream.sent)


def found_at(stream: Streamed, q: Any) -> None:
    """Report, after a pause, that the program found the arm at `q`, dropped its points, and is at rest."""
    before, report = paused(stream, q), stream.report
    stream.receive(report._replace(messages=before + 1, head=report.base, phase=RESTING))


def test_stream_resumes_from_arm_moved_in_pause() -> None:
    """The same happens at rest. A report from before the pause does not count."""
    stream = Streamed(E_SERIES, way=3)
    stream.append(waves(0.05, 0.3))
    stream.run_dry()
    rests, there = mark(stream), [*stream.path[-1][:5], stream.path[-1][5] + 0.02]
    before = paused(stream, there)
    while stream.report.messages <= before:
        assert mark(stream) is rests
        stream.run()
    assert mark(stream).time == stream.feed.time == rests.time
    assert mark(stream).moment.q == pytest.approx(there)
    assert not mark(stream).moment.qd.any()
    assert stream.feed.starved == 1
    stream.run(5)
    end = mark(stream)
    stream.run(5)
    assert mark(stream) is end  # this happens only once


def test_arm_not_moved_in_pause_continues_with_points() -> None:
    """The feed knows after fifty messages that the arm was not moved. The program is slow at first."""
    stream = moves(Streamed(E_SERIES))
    reported(stream)
    time, before = stream.feed.time, paused(stream)
    stream.run(5)
    assert stream.feed.time - time < 0.1 * 5 * stream.period
    stream.until(lambda: stream.report.messages > before + 50)
    stream.until(lambda: stream.feed.time > 2.4)
    assert stream.path[-1] == pytest.approx(wave(stream.feed.time).q, abs=3e-3)


@pytest.mark.parametrize(("messages", "is_found"), [(0, True), (50, True), (51, False)])
def test_arm_is_found_elsewhere_only_at_first_after_pause(messages: int, is_found: bool) -> None:
    """A report of rest that comes after more than fifty messages has another reason."""
    stream = moves(Streamed(E_SERIES))
    stream.way = 10_000
    there, report = wave(stream.feed.time + 0.2).q, stream.report
    before = paused(stream, there)
    stream.run(60)
    stream.receive(report._replace(messages=before + messages))
    stream.receive(report._replace(messages=before + messages + 1, head=report.base, phase=RESTING))
    assert stream.sent[-1][0] == CUT
    assert (position_in(stream.sent[-1]) == pytest.approx(there, abs=1e-6)) is is_found


def test_points_passed_while_braking_are_skipped_after_pause() -> None:
    """The first point that can be reached in its time is next. Here, the program is found at rest, further along."""
    stream = moves(Streamed(E_SERIES))
    time = stream.feed.time
    found_at(stream, wave(time + 0.2).q)
    assert stream.feed.time == pytest.approx(time, abs=0.005)
    assert stream.sent[-1][0] == CUT
    assert position_in(stream.sent[-1]) == pytest.approx(wave(time + 0.2).q, abs=1e-6)
    stream.run()
    assert stream.sent[-1][0] == POINT
    assert position_in(stream.sent[-1]) == pytest.approx(wave(0.8).q, abs=1e-6)
    assert stream.sent[-1][3] / SCALE == pytest.approx(0.8 - time, abs=0.005)


def test_pause_before_first_point_changes_only_start() -> None:
    stream = Streamed(E_SERIES)
    margin = stream.feed.margin
    rests, before = mark(stream), paused(stream, turned(0.02))
    stream.receive(stream.report._replace(messages=before))
    assert mark(stream) is rests  # the report was sent before the pause ended
    stream.until(lambda: stream.report.messages > before)
    assert mark(stream).moment.q == pytest.approx(turned(0.02))
    assert (stream.feed.margin, stream.feed.starved) == (margin, 0)


def test_unreachable_points_after_pause_end_stream() -> None:
    """The arm was moved beyond the range of a joint."""
    stream = moves(Streamed(E_SERIES))
    with pytest.raises(ToleranceExceeded, match=r"no path within the limits leads from .* to the point at 0\.5 s"):
        found_at(stream, turned(6.4))


# -- abandoned points --------------------------------------------------------------------------------------


def test_unsent_points_of_an_abandoned_call_are_removed() -> None:
    """The next points begin where the previous ones end; if no points are left, they begin at rest."""
    stream = Streamed(E_SERIES)
    feed = stream.feed
    rests = mark(stream)
    one, two, three = (stream.append(waves(t + 0.05, t + 0.5)) for t in (0.0, 0.5, 1.0))
    for abandoned in (three, one):
        feed.forget(abandoned)
        assert mark(stream).time == pytest.approx(1.0)
        assert mark(stream).moment.q == pytest.approx(wave(1.0).q)
    feed.forget(two)
    assert mark(stream).time == rests.time
    assert mark(stream).moment.q == pytest.approx(HOME)
    assert not mark(stream).moment.qd.any()
    stream.run(10)
    assert feed.is_dry
    assert not np.ptp(stream.path or [list(HOME)], axis=0).any()


def test_sent_points_of_an_abandoned_call_are_still_reached() -> None:
    stream = Streamed(E_SERIES, buffer=0.3)
    handed = stream.append(waves(0.05, 1.0))
    stream.until(lambda: stream.feed.time > 0.2)
    stream.feed.forget(handed)
    end = mark(stream)
    assert 0.4 < end.time == stream.feed.reach(100.0) < 0.6
    assert end.moment.q == pytest.approx(wave(end.time).q)
    stream.append(waves(end.time + 0.05, 1.0))
    stream.until(lambda: stream.feed.time > 0.95)
    assert stream.feed.starved == 0


def test_points_of_cancelled_task_are_not_sent() -> None:
    stream = Streamed(E_SERIES)
    one, two = stream.append(waves(0.05, 0.2)), stream.append(waves(0.25, 0.5))
    two.call = cast(PendingCall, SimpleNamespace(is_given_up=True))
    stream.run_dry()
    assert stream.feed.time == mark(stream).time == pytest.approx(0.2)
    assert one.future.exception() is None
    with pytest.raises(Cancelled, match="the task that appended these points was cancelled"):
        two.future.result(0.0)


def test_points_abandoned_after_clear_keep_end() -> None:
    """The rest of the cut step is still executed."""
    stream = moves(Streamed(E_SERIES))
    cleared = stream.feed.replace(0.0, ())
    rests = mark(stream)
    assert not rests.moment.qd.any()
    stream.feed.forget(stream.append(TrajectoryPoint(rests.moment.q, rests.time + 0.5)))
    end = mark(stream)
    stream.until(cleared.done)
    assert end.time == rests.time == cleared.result()
    assert end.moment.q == pytest.approx(wave(end.time).q, abs=2e-6)
    assert end.moment.qd == pytest.approx(wave(end.time).qd, abs=1e-4)


def test_stream_is_dry_after_points_behind_a_cut_were_dropped() -> None:
    """The program has opened an epoch for points that will not be sent."""
    stream = Streamed(E_SERIES)
    handed = stream.append(waves(0.05, 0.5))
    stream.run()
    stream.feed.forget(handed)
    assert not stream.feed.is_dry
    dry = stream.feed.dry()
    stream.until(dry.done, 1.0)
    stream.append(TrajectoryPoint(turned(0.1), mark(stream).time + 1.0, [0] * 6, [0] * 6))
    assert not stream.feed.is_dry
    stream.run_dry()
    assert stream.path[-1] == pytest.approx(turned(0.1), abs=1e-3)


# -- several arms ------------------------------------------------------------------------------------------


class Paces:
    """Fake of the common pace of several arms: `wanted` is the pace, `looks` the reports of each cycle."""

    def __init__(self) -> None:
        self.wanted, self.change = 1.0, 0.0
        self.looks: list[SimpleNamespace] = []

    def look(self, *seconds: float, **what: Any) -> float:
        self.looks.append(SimpleNamespace(**what))
        self.wanted -= self.change
        return self.wanted


@pytest.mark.parametrize(("change", "paces"), [(0.0, 0), (0.0004, 2), (0.0015, 3)])
def test_pace_change_of_0_1_percent_is_sent_before_a_point(change: float, paces: int) -> None:
    """The program receives one message in each cycle."""
    stream, pace = Streamed(E_SERIES), Paces()
    stream.feed.pace = cast(MemberPace, pace)
    stream.run(5)
    messages = messages_of(stream)
    stream.append(waves(0.05, 1.0))
    stream.run(2)  # the first cut and the first point
    pace.change = change
    messages.clear()
    stream.run(6)
    kinds = [what for what, *_ in messages]
    assert (kinds.count(WAIT), kinds.count(POINT)) == (paces, 6 - paces)


def test_stream_reports_its_motion_to_the_common_pace() -> None:
    stream, paces = Streamed(E_SERIES), Paces()
    stream.feed.pace = cast(MemberPace, paces)
    stream.run(5)
    assert (paces.looks[-1].is_led, paces.looks[-1].is_idle) == (False, True)
    moves(stream)
    assert (paces.looks[-1].is_led, paces.looks[-1].is_idle) == (True, False)
    # Without a report for a tenth of a second, the arm counts as passing no points; the last report is some ms old.
    stream.way = 10_000
    paces.looks.clear()
    stream.run(100)
    assert [look.is_led for look in paces.looks].index(False) == pytest.approx(0.09 / stream.period, abs=6)


def test_stream_time_is_correct_while_the_pace_changes() -> None:
    """The error stays within the two cycles that a pace needs to arrive."""
    stream, paces = Streamed(E_SERIES), Paces()
    stream.feed.pace = cast(MemberPace, paces)
    stream.append(waves(0.05, 2.0))
    times = np.linspace(0.0, 1.5, 15001)
    angles = [wave(t).q[5] for t in times]
    errors: list[float] = []
    for paces.wanted in (1.0, 0.5, 0.05, 1.0, 0.0, 0.7):
        for _ in range(150):
            stream.run()
            time = float(np.interp(stream.path[-1][5] if stream.path else 0.0, angles, times))
            if 0.35 < time < 1.45:
                errors.append((stream.feed.time - time) / stream.period)
    assert len(errors) > 500
    assert min(errors) > -2.5
    assert max(errors) < 0.5

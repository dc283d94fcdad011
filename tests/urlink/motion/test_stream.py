"""Endless streams: the feed and the program that buffers its points, cycle by cycle."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from linkcore.errors import BadValue, Cancelled
from tests.fakes.rehearsal import HOME, turned
from tests.matrix import trials
from tests.urlink.motion.streamed import ACCELERATION, JERK, Streamed
from urlink.arm.kinematics import Arm, Unreachable
from urlink.arm.vectors import FloatArray
from urlink.motion import PosePoint
from urlink.motion.moves.trajectory import Trajectory, TrajectoryPoint
from urlink.protocol.firmware import Firmware
from urlink.script.links import STARVED

FIRMWARES = [Firmware.parse(each) for each in ("3.4", "5.11", "10.12")]
E_SERIES = Firmware(5, 11)
#: Rounding of messages: half a micrometre at the end of a long arm.
ROUNDING = 5e-7
STILL = [0.0] * 6
#: Offset from the wave to another wave, in rad.
BESIDE = np.array([0.01, 0, 0, 0, 0, 0.02])


def wave(t: float, degree: int = 5, size: float = 0.1, rate: float = 2.0) -> TrajectoryPoint:
    """Return a point on a wave of the last joint and the base that begins at rest, without acceleration."""
    way = np.array([0.3, 0, 0, 0, 0, 1.0]) * size
    c, s = math.cos(rate * t), math.sin(rate * t)
    q = np.array(HOME) + (1.0 - c) ** 2 * way
    qd, qdd = 2.0 * rate * (1.0 - c) * s * way, 2.0 * rate**2 * (s * s + (1.0 - c) * c) * way
    return TrajectoryPoint(q, t, qd if degree > 1 else None, qdd if degree > 3 else None)


def there(angle: float, t: float, *more: Any) -> TrajectoryPoint:
    """Return a point with wrist 3 turned."""
    return TrajectoryPoint(turned(angle), t, *more)


def waves(first: float, last: float, spacing: float = 0.05, degree: int = 5) -> list[TrajectoryPoint]:
    count = round((last - first) / spacing)
    return [wave(first + i * spacing, degree) for i in range(count + 1)]


def moving(stream: Streamed, since: int = 0) -> int:
    """Return the index of the set-point where the motion begins."""
    path = np.array(stream.path)
    return int(np.argmax(np.abs(path - path[since]).max(axis=1) > 1e-12)) - 1


class TestMoving:
    @pytest.mark.parametrize("firmware", FIRMWARES, ids=str)
    @pytest.mark.parametrize(("degree", "error"), [(1, 1e-3), (3, 3e-5), (5, 2e-6)])
    def test_set_points_are_on_curve_of_points(self, firmware: Firmware, degree: int, error: float) -> None:
        stream = Streamed(firmware)
        stream.append(waves(0.05, 2.0, degree=degree))
        stream.until(lambda: stream.feed.time > 1.9)
        # An interpolated point is on the wave, apart from the remainder of its series.
        begin = moving(stream)
        path = np.array(stream.path[begin : begin + round(1.8 / stream.period)])
        wanted = np.array([wave(i * stream.period).q for i in range(len(path))])
        assert np.abs(path - wanted).max() < error
        assert stream.feed.starved == 0

    def test_stream_reaches_every_point_of_mixed_degrees(self) -> None:
        stream = Streamed(E_SERIES)
        for i in range(1, 41):
            stream.append(wave(i * 0.05, (1, 3, 5)[i % 3]))
        stream.until(lambda: stream.feed.time > 1.9)
        begin = moving(stream)
        at = begin + np.round(np.arange(0.0, 1.85, 0.05) / stream.period).astype(int)
        path = np.array(stream.path)[at]
        assert np.abs(path - [wave(0.05 * i).q for i in range(len(at))]).max() < 2e-6

    @pytest.mark.slow
    @pytest.mark.parametrize("buffer", [0.1, 0.5])
    def test_buffer_holds_requested_time(self, buffer: float) -> None:
        stream = Streamed(E_SERIES, buffer=buffer)
        handed = stream.append(waves(0.02, 2.0, 0.02))
        stream.until(lambda: stream.feed.time > 0.6)
        assert buffer - 0.03 <= stream.feed.ahead <= buffer + 0.02
        assert not handed.future.done()
        stream.until(lambda: stream.feed.time > 2.0 - buffer + 0.02)
        assert handed.future.done()

    @pytest.mark.slow
    def test_trajectory_starts_at_end_of_points(self) -> None:
        stream = Streamed(E_SERIES)
        there = Trajectory.from_arrays([0, 0.4, 0.8], [turned(0), turned(0.1), turned(0.2)])
        dense = Trajectory.from_arrays(
            np.linspace(0, 1, 901), [turned(0.2 - 0.2 * u * u * (3 - 2 * u)) for u in np.linspace(0, 1, 901)]
        )
        stream.append(there)
        stream.append(dense)
        assert stream.feed.mark is not None
        assert stream.feed.mark.time == pytest.approx(1.8)
        begin = moving(stream) if stream.path else 0
        stream.run_dry()
        begin = moving(stream)
        path = np.array(stream.path[begin : begin + round(1.8 / stream.period)])[:, 5]
        t = np.arange(len(path)) * stream.period
        wanted = np.where(t < 0.8, there.at(t)[0][:, 5], dense.at(t - 0.8)[0][:, 5])
        assert np.abs(path - wanted).max() < 2e-5
        assert stream.feed.starved == 0

    def test_replacement_starts_at_end_of_sent_points_at_latest(self) -> None:
        stream = Streamed(E_SERIES, buffer=0.3)
        stream.append(waves(0.05, 3.0))
        stream.until(lambda: stream.feed.time > 0.5)
        sent = stream.feed.reach(100.0)
        assert stream.feed.reach(0.0) < sent == stream.feed.reach(200.0)
        assert sent - stream.feed.time == pytest.approx(0.3, abs=0.1)

    def test_poses_are_reached_by_inverse_kinematics(self) -> None:
        stream = Streamed(E_SERIES)
        arm = Arm("UR5e")
        poses = [arm.forward(HOME) + np.array([0, 0, 0.002 * i, 0, 0, 0]) for i in range(1, 21)]
        stream.append([PosePoint(pose, 0.05 * (i + 1)) for i, pose in enumerate(poses)])
        stream.run_dry()
        # The arm brakes beyond the last pose, because it was moving there.
        heights = [arm.forward(q)[2] for q in stream.path[:: round(0.05 / stream.period)]]
        assert max(heights) == pytest.approx(poses[-1][2], abs=0.01)
        there = arm.forward(stream.path[moving(stream) + round(1.0 / stream.period)])
        assert np.abs(there - poses[-1])[:3].max() < 1e-5

    def test_time_follows_motion_of_arm(self) -> None:
        stream = Streamed(E_SERIES)
        assert stream.feed.time == 0.0
        stream.append(waves(0.05, 1.0))
        stream.run(20)
        begin = moving(stream)
        seen = []
        for _ in range(300):
            stream.run()
            seen.append(stream.feed.time - (len(stream.path) - begin) * stream.period)
        # The time is known from reports that are one or two cycles old.
        assert max(map(abs, seen)) < 4 * stream.period


class TestDry:
    @pytest.mark.parametrize("firmware", FIRMWARES, ids=str)
    @pytest.mark.parametrize("degree", [1, 3, 5])
    def test_dry_stream_brakes_within_limits_and_resumes(self, firmware: Firmware, degree: int) -> None:
        stream = Streamed(firmware)
        stream.append(waves(0.05, 0.6, degree=degree))
        stream.until(lambda: stream.feed.time > 0.59)
        last = len(stream.path)
        stream.run_dry()
        _, qdd, qddd = stream.derivatives(last + 3)
        assert np.abs(qdd).max() < ACCELERATION * 1.01
        assert np.abs(qddd).max() < JERK * 1.05 + 1e-8 / stream.period**3
        assert stream.feed.starved == 1
        assert stream.feed.time == pytest.approx(0.6)
        stream.run(50)
        rests = np.array(stream.path[-40:])
        assert (rests == rests[0]).all()
        resting = len(stream.path)
        stream.append(waves(0.65, 1.6, degree=degree))
        stream.until(lambda: stream.feed.time > 1.55)
        # The arm moves from rest onto the points.
        path = np.array(stream.path[resting:])
        missed = [np.abs(path - wave(0.65 + 0.05 * i).q).max(axis=1).min() for i in range(18)]
        assert max(missed) < 0.01
        assert not stream.bench.execution.is_over

    def test_points_that_end_at_rest_do_not_count_as_starved(self) -> None:
        stream = Streamed(E_SERIES)
        stream.append(Trajectory.from_arrays([0, 0.5], [turned(0), turned(0.1)]))
        stream.run_dry()
        stream.append(Trajectory.from_arrays([0, 0.5], [turned(0.1), turned(0)]))
        stream.run_dry()
        assert stream.feed.starved == 0
        assert stream.path[-1] == pytest.approx(HOME, abs=ROUNDING)
        assert stream.feed.time == pytest.approx(1.0)

    @pytest.mark.slow
    @pytest.mark.matrix(4)
    @pytest.mark.parametrize("late", range(1, 200, 7))
    def test_points_arriving_while_braking_are_reached(self, late: int) -> None:
        stream = Streamed(E_SERIES, way=late % 5)
        stream.append(waves(0.05, 0.6))
        stream.until(lambda: stream.feed.time > 0.5)
        stream.run(round(0.1 / stream.period) - 20 + late)
        stream.append(waves(0.65, 1.6))
        stream.until(lambda: stream.feed.time > 1.55)
        _, qdd, qddd = stream.derivatives(moving(stream) + 3)
        assert np.abs(qdd).max() < ACCELERATION * 1.01
        assert np.abs(qddd).max() < JERK * 1.1 + 1e-8 / stream.period**3
        path = np.array(stream.path)
        assert max(np.abs(path - wave(1.0 + 0.05 * i).q).max(axis=1).min() for i in range(10)) < 2e-3

    @pytest.mark.slow
    def test_stream_continues_while_the_computer_is_frozen(self) -> None:
        stream = Streamed(E_SERIES, buffer=0.3)
        stream.append(waves(0.05, 3.0))
        stream.until(lambda: stream.feed.time > 0.5)
        stream.run(100, is_frozen=True)
        stream.until(lambda: stream.feed.time > 2.9)
        assert stream.feed.starved == 0
        begin = moving(stream)
        path = np.array(stream.path[begin : begin + round(2.8 / stream.period)])
        wanted = np.array([wave(i * stream.period).q for i in range(len(path))])
        assert np.abs(path - wanted).max() < 2e-6

    def test_report_sent_before_the_computer_froze_counts_as_old(self) -> None:
        stream = Streamed(E_SERIES, buffer=0.5)
        stream.append(waves(0.05, 3.0))
        stream.until(lambda: stream.feed.time > 0.5)
        for _ in range(11):  # one more than the number of messages between two reports
            before, cycles = stream.feed.time, stream.bench.cycle
            stream.run(50, is_frozen=True)
            stream.run()
            passed = (stream.bench.cycle - cycles) * stream.period
            assert stream.feed.time - before == pytest.approx(passed, abs=2 * stream.period)
            stream.run(10)


class TestReplaced:
    @pytest.mark.matrix(5)
    @pytest.mark.parametrize("firmware", FIRMWARES, ids=str)
    @pytest.mark.parametrize("way", [0.0, 0.005, 0.04])
    @pytest.mark.parametrize("degree", [3, 5])
    def test_replaced_tail_continues_from_same_moment(self, firmware: Firmware, way: float, degree: int) -> None:
        stream = Streamed(firmware, way=round(way * firmware.rate))
        stream.append(waves(0.05, 3.0, degree=5))
        stream.until(lambda: stream.feed.time > 0.6)
        now = stream.feed.time
        # A chunk that began in the past, at an offset from the points.
        chunk = [
            TrajectoryPoint(point.q + BESIDE, point.time, point.qd, point.qdd)
            for point in waves(0.4, 1.85, degree=degree)
        ]
        since = stream.replace(0.4, chunk)
        assert now < since < now + 1.0
        stream.until(lambda: stream.feed.time > 1.8)
        _, qdd, qddd = stream.derivatives(moving(stream) + 3)
        assert np.abs(qdd).max() < ACCELERATION * 1.01
        if degree == 5:
            assert np.abs(qddd).max() < JERK * 1.1 + 1e-8 / stream.period**3
        at = moving(stream) + np.round(np.arange(since + 0.3, 1.7, 0.05) / stream.period).astype(int)
        wanted = [wave((i - moving(stream)) * stream.period).q + BESIDE for i in at]
        assert np.abs(np.array(stream.path)[at] - wanted).max() < 1e-4
        assert stream.feed.starved == 0
        stream.run_dry()
        assert stream.feed.time == pytest.approx(chunk[-1].time)

    @pytest.mark.slow
    @pytest.mark.parametrize("since", [0.5, 0.633, 1.2, 1.211, 5.0])
    def test_replacement_starts_at_given_time(self, since: float) -> None:
        stream = Streamed(E_SERIES)
        stream.append(waves(0.05, 2.0))
        stream.until(lambda: stream.feed.time > 0.4)
        still = wave(min(since, 2.0)).q
        chunk = [TrajectoryPoint(still, min(since, 2.0) + 1.0 + 0.1 * i, [0] * 6, [0] * 6) for i in range(5)]
        assert stream.replace(since, chunk) == pytest.approx(min(since, 2.0), abs=stream.period)
        stream.run_dry()
        begin = moving(stream)
        path = np.array(stream.path[begin : begin + round(min(since, 1.9) / stream.period)])
        wanted = np.array([wave(i * stream.period).q for i in range(len(path))])
        assert np.abs(path - wanted).max() < 2e-6
        _, qdd, qddd = stream.derivatives(begin + 3)
        assert np.abs(qdd).max() < ACCELERATION
        assert np.abs(qddd).max() < JERK * 1.05 + 1e-8 / stream.period**3
        assert stream.path[-1] == pytest.approx(still, abs=ROUNDING)

    @pytest.mark.slow
    def test_unreachable_replacement_keeps_points(self) -> None:
        stream = Streamed(E_SERIES)
        stream.append(waves(0.05, 2.0))
        stream.until(lambda: stream.feed.time > 0.4)
        with pytest.raises(BadValue, match=r"cannot be reached from the position of the stream at 0\.[45]"):
            stream.replace(0.4, [TrajectoryPoint(turned(2.0), 0.6, [0] * 6)])
        with pytest.raises(BadValue, match=r"all points are in the past: the last is at 0\.3 s"):
            stream.replace(0.0, waves(0.05, 0.3))
        stream.until(lambda: stream.feed.time > 1.9)
        begin = moving(stream)
        path = np.array(stream.path[begin : begin + round(1.8 / stream.period)])
        assert np.abs(path - [wave(i * stream.period).q for i in range(len(path))]).max() < 2e-6

    def test_rejected_replacement_at_rest_keeps_points(self) -> None:
        stream = Streamed(E_SERIES)
        handed = stream.append(waves(0.05, 1.0))
        stream.run_dry()
        stream.append([TrajectoryPoint(turned(0.1), 2.0, [0] * 6, [0] * 6)])
        with pytest.raises(BadValue, match=r"all points are in the past: the last is at 0\.3 s"):
            stream.replace(0.0, waves(0.05, 0.3))
        stream.run_dry()
        assert handed.future.exception() is None
        assert stream.path[-1] == pytest.approx(turned(0.1), abs=ROUNDING)

    def test_clear_works_after_late_replacement(self) -> None:
        """Clear while the replacement is on its way, and again after it was rejected as too late."""
        stream = Streamed(E_SERIES, buffer=1.0, way=25)
        stream.append(waves(0.05, 3.0))
        stream.until(lambda: stream.feed.time > 0.6)
        assert stream.feed.mark is not None
        margin = stream.feed.margin
        replaced = stream.feed.replace(0.0, stream.reader.curve(waves(0.05, 3.0), 0.0, stream.feed.mark))
        stream.run(5)
        first, second = stream.feed.replace(0.0, ()), stream.feed.replace(0.0, ())
        stream.until(lambda: replaced.done() and first.done() and second.done())
        assert stream.feed.margin > margin
        assert 0.6 < replaced.result() < first.result() <= second.result() < 2.0
        stream.run_dry()
        assert stream.feed.time == pytest.approx(second.result())

    def test_replacement_at_rest_starts_motion(self) -> None:
        stream = Streamed(E_SERIES)
        stream.replace(0.0, [TrajectoryPoint(turned(0.01 * i), 0.05 * i, [0, 0, 0, 0, 0, 0.2]) for i in range(20)])
        stream.run_dry()
        assert max(q[5] for q in stream.path) == pytest.approx(0.19, abs=0.03)
        assert stream.feed.time == pytest.approx(0.95)
        _, qdd, _ = stream.derivatives()
        assert np.abs(qdd).max() < ACCELERATION

    @pytest.mark.parametrize("at", [0.3, 0.55, 0.59, 0.7, 1.5])
    def test_cleared_stream_stops_and_can_continue(self, at: float) -> None:
        stream = Streamed(E_SERIES)
        handed = stream.append(waves(0.05, 0.6))
        stream.run(round(at / stream.period))
        ended = stream.clear()
        assert ended < 0.6 + 1e-9
        stream.run_dry()
        assert stream.feed.time == pytest.approx(ended)
        assert stream.feed.mark is not None
        assert stream.feed.mark.time == ended
        assert stream.path[-1] == pytest.approx(stream.feed.mark.moment.q, abs=1e-5)
        assert stream.feed.starved == (1 if at > 0.6 else 0)
        if not handed.future.done() or handed.future.exception() is not None:
            assert at < 0.6
            with pytest.raises(Cancelled):
                handed.future.result()
        here = np.array(stream.path[-1])
        stream.append([TrajectoryPoint(here, ended), TrajectoryPoint(here + 0.05, ended + 0.5, [0] * 6, [0] * 6)])
        stream.run_dry()
        _, qdd, qddd = stream.derivatives(moving(stream) + 3)
        assert np.abs(qdd).max() < ACCELERATION
        assert np.abs(qddd).max() < JERK * 1.05 + 1e-8 / stream.period**3


class TestRejected:
    @pytest.mark.parametrize(
        ("points", "message"),
        [
            (lambda: [], "there are no points"),
            (lambda: 3, "points is 3; expected a sequence of TrajectoryPoint or PosePoint"),
            (lambda: [3], "point 0 is 3; expected a TrajectoryPoint or a PosePoint"),
            (lambda: [wave(0.1), wave(0.101)], r"point 1 \(t = 0.101 s\): .* is 0.001 s after .* expected 0.004 s"),
            (lambda: [wave(0.1), wave(0.1)], r"point 1 \(t = 0.1 s\): its time is 0 s after"),
            (lambda: wave(2000.0), r"its time is 2000 s after .* to 1000 s"),
            (
                lambda: there(2.0, 0.1),
                r"point 0 \(t = 0.1 s\): speed of wrist 3 .* is 20.0000 rad/s; .* UR5e is 3.1416",
            ),
            (lambda: there(0.2, 0.1, STILL), r"acceleration of wrist 3 \(joint 5\) is 120.0000 rad/s²; .* 40"),
            (lambda: there(0.2, 0.0), r"wrist 3 \(joint 5\) is at 0.2000 rad, 0.2000 rad from .* at most 0.05 rad"),
            (lambda: there(7.0, 9.0), r"position of wrist 3 \(joint 5\) is 6\.\d+ rad; the limit .* 6.2832 rad"),
            (
                lambda: [there(3.0, 3.0, STILL), there(6.27, 6.0, [*STILL[:5], 1.0])],
                r"point 1 .*: position after braking, if no point followed, of wrist 3",
            ),
            (lambda: there(0.1, 0.5, None, STILL), "point 0 has accelerations without velocities"),
            (
                lambda: Trajectory.from_arrays([0, 1], [turned(0.3), turned(0.4)]),
                r"point 0 \(t = 0 s\): wrist 3 .* 0.3000 rad from",
            ),
        ],
    )
    def test_impossible_points_are_rejected(self, points: Callable[[], Any], message: str) -> None:
        stream = Streamed(E_SERIES)
        with pytest.raises(BadValue, match=message):
            stream.append(points())
        stream.run(5)
        assert stream.feed.is_dry

    def test_pose_beyond_singularity_is_rejected(self) -> None:
        """Reaching it needs another branch, or joint turns that are too large for a step of a stream."""
        arm, stream = Arm("UR5e"), Streamed(E_SERIES)
        far = arm.forward([HOME[0] + 2.5, *HOME[1:]])
        with pytest.raises(BadValue, match=r"point 0 \(t = 9 s\): base \(joint 0\) would jump from "):
            stream.append(PosePoint(far, 9.0))

    def test_pose_out_of_reach_is_rejected(self) -> None:
        stream = Streamed(E_SERIES)
        with pytest.raises(Unreachable):
            stream.append(PosePoint([3, 0, 0, 0, 0, 0], 1.0))


class TestEnd:
    def test_stream_without_messages_brakes_and_ends(self) -> None:
        stream = Streamed(E_SERIES, buffer=0.3, watchdog=0.1)
        stream.append(waves(0.05, 3.0))
        stream.until(lambda: stream.feed.time > 0.5)
        begin = len(stream.path)
        stream.run(500, is_frozen=True)
        assert STARVED in stream.bench.said
        _, qdd, qddd = stream.derivatives(begin)
        assert np.abs(qdd).max() < ACCELERATION
        assert np.abs(qddd).max() < JERK * 1.05 + 1e-8 / stream.period**3
        assert stream.path[-1] == pytest.approx(stream.path[-2], abs=1e-5)

    def test_stop_brakes_within_limits(self) -> None:
        stream = Streamed(E_SERIES)
        stream.append(waves(0.05, 3.0))
        stream.until(lambda: stream.feed.time > 0.5)
        begin = len(stream.path)
        stream.bench.sockets.waiting += stream.feed.farewell + bytes(4)
        stream.run(300, is_frozen=True)
        assert stream.bench.has_finished
        assert stream.bench.said == []
        _, qdd, qddd = stream.derivatives(begin)
        assert np.abs(qdd).max() < ACCELERATION
        assert np.abs(qddd).max() < JERK * 1.05 + 1e-8 / stream.period**3
        assert len(stream.path) - begin < 200


def random_points(rng: np.random.Generator, count: int, q: FloatArray) -> list[TrajectoryPoint]:
    """Return points at random intervals, with random derivatives (none, speeds, or speeds and accelerations), at
    speeds up to 1 rad/s."""
    made, t = [], 0.0
    for _ in range(count):
        h = float(rng.uniform(0.05, 0.4))
        t += h
        q = q + rng.uniform(-0.3, 0.3, 6) * h
        degree = rng.integers(3)
        qd = rng.uniform(-0.3, 0.3, 6) if degree else None
        made.append(TrajectoryPoint(q, t, qd, rng.uniform(-1.0, 1.0, 6) if degree == 2 else None))
    return made


@pytest.mark.slow
@pytest.mark.matrix
@pytest.mark.parametrize("seed", range(trials(8, 1000)))
def test_stream_starves_at_every_point_and_continues(seed: int) -> None:
    """The arm comes to rest within the limits after each point, and continues with the next one over the same link."""
    rng = np.random.default_rng(seed)
    stream = Streamed(Firmware(3, 4) if seed % 2 else E_SERIES, way=seed % 3)
    for number, point in enumerate(random_points(rng, 6, np.array(HOME)), 1):
        try:
            stream.append(point)
        except BadValue:  # too hard for a curve
            stream.append(TrajectoryPoint(point.q, point.time))
        assert stream.feed.mark is not None
        last = stream.feed.mark.moment
        stream.until(lambda point=point: stream.feed.time >= point.time - 1e-9)
        begin = len(stream.path)
        stream.run_dry()
        _, qdd, _ = stream.derivatives(begin + 2)
        # Points may need more acceleration than the stream adds.
        assert np.abs(qdd).max(initial=0.0) < max(ACCELERATION, np.abs(last.qdd).max())
        # The arm does not overshoot far: only as far as the slower of both bounds requires.
        fastest = np.abs(last.qd).max()
        braking = max(2.2 * fastest / ACCELERATION, (6.0 * fastest / JERK) ** 0.5, 0.35)
        assert np.abs(np.array(stream.path[-1]) - last.q).max() < 0.5 * fastest * braking + 0.06
        rests = stream.bounds.braked(last).q
        assert stream.path[-1] == pytest.approx(rests, abs=1e-4)
        assert stream.feed.starved <= number
    assert stream.feed.starved >= 5
    assert not stream.bench.execution.is_over
    assert stream.bench.said == []

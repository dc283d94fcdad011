"""Calls of a point stream, on a robot that the test plays and that accepts no points."""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from types import SimpleNamespace
from typing import Any, cast

import pytest

from linkcore.errors import BadValue, Cancelled, Closed, ConnectionLost, LinkTimeout, LocalError
from tests.fakes.rehearsal import HOME, Rehearsal, turned
from tests.urlink.motion.test_blocks import entered
from urlink.arm.kinematics import Arm
from urlink.motion import PosePoint
from urlink.motion.moves.trajectory import Trajectory, TrajectoryPoint
from urlink.motion.stream.common_time import MemberPace
from urlink.motion.stream.stream_feed import StreamFeed
from urlink.motion.stream.stream_steps import Aim

pytestmark = pytest.mark.simulated_time


def there(angle: float, t: float) -> TrajectoryPoint:
    return TrajectoryPoint(turned(angle), t)


# -- start -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("firmware", "buffer", "capacity"),
    [("5.11", 0.3, 79), ("5.11", 0.5, 129), ("5.11", 10.0, 256), ("3.4", 0.48, 34), ("3.4", 0.05, 7)],
)
def test_stream_buffer_time_determines_the_number_of_points(
    rehearsal: Callable[..., Rehearsal], firmware: str, buffer: float, capacity: int
) -> None:
    """Points are two cycles apart, and there are at most 256."""
    robot = rehearsal(firmware, "UR5" if firmware < "5" else "UR5e")
    with entered(robot, robot.motion.stream(buffer, watchdog=0.5)) as stream:
        assert stream.buffer == buffer
        assert f"head - base < {capacity}:" in robot.uploaded
        assert all(
            len(each.split(",")) == capacity for each in re.findall(r"kept_degree = \[([0, ]+)\]", robot.uploaded)
        )


def test_old_firmware_cannot_buffer_points(rehearsal: Callable[..., Rehearsal]) -> None:
    for firmware, model, why in (
        ("1.8", "UR5", "CB2 controllers cannot read binary messages"),
        ("3.3", "UR5", "its URScript does not have the required functions"),
    ):
        robot = rehearsal(firmware, model)
        with pytest.raises(
            LocalError, match=rf"firmware {firmware} cannot buffer points of a stream: {why}; 3\.4 or later"
        ):
            robot.motion.stream()


def test_stream_rejects_calls_outside_block(robot: Rehearsal) -> None:
    stream = robot.motion.stream()
    assert (stream.time, stream.end, stream.buffered, stream.room, stream.starved) == (0.0, 0.0, 0.0, 0.5, 0)
    assert stream.is_dry
    calls: list[Callable[[], object]] = [
        lambda: stream.append(there(0.1, 1.0)),
        lambda: stream.replace(0.0, there(0.1, 1.0)),
        stream.clear,
        stream.wait_until_dry,
    ]
    for call in calls:
        with pytest.raises(LocalError, match="is not open; use it within its block"):
            call()


# -- points ------------------------------------------------------------------------------------------------


@pytest.fixture
def stream(robot: Rehearsal) -> Any:
    """Stream in its block; no state arrives, so no point is sent."""
    with entered(robot, robot.motion.stream(0.5)) as stream:
        while not stream._feed.begun.done():
            robot.show()
        yield stream


def test_end_and_room_include_points_that_are_not_yet_sent(stream: Any) -> None:
    assert stream.append([there(0.1, 0.4), there(0.2, 0.8)], wait=False) == pytest.approx(-0.3)
    assert (stream.end, stream.time, stream.is_dry) == (0.8, 0.0, False)
    assert stream.buffered == 0.8
    assert stream.room == pytest.approx(-0.3)


def test_stream_properties_return_values_of_the_feed(stream: Any) -> None:
    stream._feed = SimpleNamespace(time=3.0, mark=SimpleNamespace(time=2.0), starved=7, is_dry=True)
    assert (stream.time, stream.end, stream.buffered, stream.room, stream.starved) == (3.0, 2.0, 0.0, 0.5, 7)
    assert stream.is_dry


@pytest.mark.parametrize(
    ("call", "seconds", "why"),
    [
        (lambda stream: stream.append(there(0.1, 0.4), wait=0.3), 0.3, "had no room for the points within 0.3 s"),
        (lambda stream: stream.wait_until_dry(0.7), 0.7, "the stream did not run dry within 0.7 s"),
    ],
)
def test_each_wait_of_a_point_stream_times_out(
    stream: Any, call: Callable[[Any], object], seconds: float, why: str
) -> None:
    stream.append(there(0.05, 0.2), wait=False)
    begin = time.monotonic()
    with pytest.raises(LinkTimeout, match=re.escape(why)):
        call(stream)
    assert time.monotonic() - begin == pytest.approx(seconds, abs=0.05)


@pytest.mark.parametrize(
    ("call", "why"),
    [
        (lambda stream: stream.replace(0.0, there(0.1, 0.4)), "did not confirm the change of its points within 10 s"),
        (lambda stream: stream.clear(), "did not confirm the change of its points within 10 s"),
        (lambda stream: stream._await_answer(), "the robot did not answer within 10 s"),
    ],
)
def test_stream_change_times_out_after_ten_seconds(stream: Any, call: Callable[[Any], object], why: str) -> None:
    never: Future[Any] = Future()
    stream._feed.replace = lambda since, curve: never
    stream._feed.answered = lambda: never
    begin = time.monotonic()
    with pytest.raises(LinkTimeout, match=why):
        call(stream)
    assert time.monotonic() - begin == pytest.approx(10.0, abs=0.05)


@pytest.mark.parametrize("call", [lambda stream: stream.clear(), lambda stream: stream.wait_until_dry(30.0)])
def test_calls_time_out_if_arm_does_not_come_to_rest(robot: Rehearsal, call: Callable[[Any], object]) -> None:
    with entered(robot, robot.motion.stream()) as stream:
        cast(Any, stream)._feed.begun = Future()  # never done, because the arm does not come to rest
        begin = time.monotonic()
        with pytest.raises(LinkTimeout, match="the arm did not come to rest within 10 s"):
            call(stream)
        assert time.monotonic() - begin == pytest.approx(10.0, abs=0.05)


def test_clear_replaces_all_points_and_wait_dry_waits_a_minute(stream: Any) -> None:
    put: list[tuple[float, Sequence[Aim]]] = []
    waited: list[float] = []
    stream._put = lambda since, curve: put.append((since, curve))
    stream._answered = lambda replaced: 0.7
    stream._await = lambda future, seconds, what: waited.append(seconds)
    assert stream.clear() == 0.7
    assert put == [(0.0, ())]
    waited.clear()
    stream.wait_until_dry()
    assert waited[-1] == 60.0
    with pytest.raises(BadValue):
        stream.wait_until_dry(float("inf"))


def test_append_waits_a_minute_for_room_by_default(stream: Any) -> None:
    waited: list[float] = []
    stream._await_room = lambda handed, seconds: waited.append(seconds)
    stream.append(there(0.1, 0.4))
    stream.append(there(0.1, 0.8), wait=False)
    assert waited == [60.0]


def test_points_from_a_second_thread_are_rejected(stream: Any) -> None:
    with stream._producing():
        with pytest.raises(LocalError, match="only one may do so at once"):
            stream.append(there(0.1, 0.4))
        with pytest.raises(LocalError, match="only one may do so at once"):
            stream.replace(0.0, there(0.1, 0.4))
        stream.clear()  # allowed in any thread
    with pytest.raises(BadValue):
        stream.append([])
    stream.append(there(0.1, 0.4), wait=False)


def test_points_are_planned_again_after_a_concurrent_clear(stream: Any) -> None:
    after, read = stream._reader.after, list[float]()

    def clears(points: Any, mark: Any, begins: float) -> Sequence[Aim]:
        read.append(mark.time)
        if len(read) == 1:
            stream._feed.skip(2.0)  # an empty stream then has another end
        return cast(Sequence[Aim], after(points, mark, begins))

    stream._reader.after = clears
    stream.append(there(0.04, 3.0), wait=False)
    assert read == [0.0, 2.0]
    assert stream.end == 3.0


def test_trajectory_may_start_later(stream: Any) -> None:
    """Set the clock forward, as for several arms, because no points are left."""
    path = Trajectory.from_arrays([0, 1], [turned(0.0), turned(0.1)])
    mark, aims = stream._checked(path, 4.0)
    assert mark.time == stream.time == 4.0
    assert [aim.time for aim in aims] == [5.0]
    mark, aims = stream._checked(path, 3.0)
    assert mark.time == 4.0


def test_pose_is_reached_with_current_tool(stream: Any) -> None:
    q = turned(0.1)
    (point,) = stream._checked(PosePoint(Arm("UR5e").forward(q), 1.0))[1]
    assert point.moment.q == pytest.approx(q, abs=1e-6)
    assert stream._curve(PosePoint(Arm("UR5e").forward(HOME), 1.0), 0.0)[0].moment.q == pytest.approx(HOME, abs=1e-6)


def test_stream_calls_are_passed_to_the_feed(stream: Any) -> None:
    asked: list[tuple[Any, ...]] = []
    stream._feed = SimpleNamespace(
        check=lambda *what: asked.append(("check", *what)),
        reach=lambda later: later + 1.0,
        is_answered="known",
    )
    stream._check(0.5, ())
    assert asked == [("check", 0.5, ())]
    assert stream._reach(0.25) == 1.25
    assert stream._is_answered == "known"


# -- its end -----------------------------------------------------------------------------------------------


def test_feed_ends_with_the_error_of_its_stream(robot: Rehearsal) -> None:
    ended: list[Exception] = []
    for error in (None, ConnectionLost("stream lost")):
        stream = robot.motion.stream()
        cast(Any, stream)._feed.end = ended.append
        if error is None:
            stream._life.finish()
        else:
            stream._life.fail(error)
        assert isinstance(ended[-1], Closed if error is None else ConnectionLost)
    assert "the block of this stream was left" in str(ended[0])


def test_call_raises_reason_of_end(stream: Any) -> None:
    failed: Future[float] = Future()
    failed.set_exception(Cancelled("dropped"))
    with pytest.raises(Cancelled, match="dropped"):
        stream._answered(failed)
    stream._life.fail(ConnectionLost("stream lost"))
    with pytest.raises(ConnectionLost, match="stream lost"):
        stream._answered(failed)
    refused: Future[float] = Future()
    refused.set_exception(ValueError("not of the link"))
    with pytest.raises(ValueError, match="not of the link"):
        stream._answered(refused)


def test_stream_joins_and_leaves_common_pace(robot: Rehearsal) -> None:
    left: list[int] = []
    pace = SimpleNamespace(is_paused=None, leave=lambda: left.append(1))
    stream = robot.motion.stream()
    stream._join(cast(MemberPace, pace))
    feed = stream._feed
    assert isinstance(feed, StreamFeed)
    assert feed.pace is cast(Any, pace)
    assert cast(Any, pace).is_paused() is False
    stream._life.finish()
    assert left == [1]

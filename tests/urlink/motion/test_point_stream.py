"""Calls of a point stream, on a robot that the test plays and that accepts no points."""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from types import SimpleNamespace
from typing import Any, cast

import pytest

from linkcore.errors import BadValue, Cancelled, Closed, LinkTimeout, LocalError
from linkcore.handle import Lifecycle
from tests.fakes.rehearsal import HOME, Rehearsal, turned
from tests.urlink.motion.test_blocks import entered
from tests.urlink.motion.test_group_stream import CALLBACKS
from tests.urlink.motion.test_group_stream import Stream as MemberStream
from tests.waiting import until
from urlink.arm.kinematics import Arm
from urlink.errors import ProgramStopped
from urlink.motion import PosePoint
from urlink.motion.moves.trajectory import Trajectory, TrajectoryPoint
from urlink.motion.stream import point_stream
from urlink.motion.stream.common_time import MemberPace
from urlink.motion.stream.group_motion import GroupStream
from urlink.motion.stream.stream_feed import StreamFeed
from urlink.motion.stream.stream_points import PointReader
from urlink.motion.stream.stream_steps import Aim
from urlink.script.buffering import MESSAGE
from urlink.script.links import STOP

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
def feeds(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """Feeds of the streams that the test makes; the test may replace their calls."""
    made: list[Any] = []

    def make(*arguments: Any) -> StreamFeed:
        made.append(StreamFeed(*arguments))
        return cast(StreamFeed, made[-1])

    monkeypatch.setattr(point_stream, "StreamFeed", make)
    return made


@pytest.fixture
def stream(robot: Rehearsal, feeds: list[Any]) -> Any:
    """Stream in its block; no state arrives, so no point is sent."""
    with entered(robot, robot.motion.stream(0.5)) as stream:
        while not feeds[0].begun.done():
            robot.show()
        yield stream


def grouped(*streams: Any) -> GroupStream:
    """Return a stream of several arms, which has these streams."""
    return GroupStream(Lifecycle("streams", CALLBACKS), streams, [f"arm {i}" for i in range(len(streams))], CALLBACKS)


def test_end_and_room_include_points_that_are_not_yet_sent(stream: Any) -> None:
    assert stream.append([there(0.1, 0.4), there(0.2, 0.8)], wait=False) == pytest.approx(-0.3)
    assert (stream.end, stream.time, stream.is_dry) == (0.8, 0.0, False)
    assert stream.buffered == 0.8
    assert stream.room == pytest.approx(-0.3)


def test_stream_properties_return_values_of_the_feed(
    stream: Any, feeds: list[Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(StreamFeed, "time", 3.0)
    monkeypatch.setattr(StreamFeed, "is_dry", True)
    feeds[0].mark, feeds[0].starved = SimpleNamespace(time=2.0), 7
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
        (lambda stream: grouped(stream).clear(), "the robot did not answer within 10 s"),
    ],
)
def test_stream_change_times_out_after_ten_seconds(
    stream: Any, feeds: list[Any], call: Callable[[Any], object], why: str
) -> None:
    never: Future[Any] = Future()
    feeds[0].replace = lambda since, curve: never
    feeds[0].answered = lambda: never
    begin = time.monotonic()
    with pytest.raises(LinkTimeout, match=why):
        call(stream)
    assert time.monotonic() - begin == pytest.approx(10.0, abs=0.05)


@pytest.mark.parametrize("call", [lambda stream: stream.clear(), lambda stream: stream.wait_until_dry(30.0)])
def test_calls_time_out_if_arm_does_not_come_to_rest(
    robot: Rehearsal, feeds: list[Any], call: Callable[[Any], object]
) -> None:
    with entered(robot, robot.motion.stream()) as stream:
        feeds[0].begun = Future()  # never done, because the arm does not come to rest
        begin = time.monotonic()
        with pytest.raises(LinkTimeout, match="the arm did not come to rest within 10 s"):
            call(stream)
        assert time.monotonic() - begin == pytest.approx(10.0, abs=0.05)


@contextmanager
def one_state_in_half_a_minute(robot: Rehearsal) -> Iterator[None]:
    """Let the stream run for more than a minute: without a state, it fails after that time."""

    def show() -> None:
        time.sleep(30.0)
        robot.tick()

    with ThreadPoolExecutor(1) as other:
        other.submit(show)
        yield


def test_clear_replaces_all_points_and_wait_dry_waits_a_minute(robot: Rehearsal, stream: Any, feeds: list[Any]) -> None:
    put: list[tuple[float, Sequence[Aim]]] = []
    done: Future[float] = Future()
    done.set_result(0.7)

    def replace(since: float, curve: Sequence[Aim]) -> Future[float]:
        put.append((since, curve))
        return done

    feeds[0].replace = replace
    assert stream.clear() == 0.7
    assert put == [(0.0, ())]
    stream.append(there(0.05, 0.2), wait=False)
    with one_state_in_half_a_minute(robot), pytest.raises(LinkTimeout, match="did not run dry within 60 s"):
        stream.wait_until_dry()
    with pytest.raises(BadValue):
        stream.wait_until_dry(float("inf"))


def test_append_waits_a_minute_for_room_by_default(robot: Rehearsal, stream: Any) -> None:
    with one_state_in_half_a_minute(robot), pytest.raises(LinkTimeout, match="had no room for the points within 60 s"):
        stream.append(there(0.1, 0.4))
    begin = time.monotonic()
    stream.append(there(0.1, 0.8), wait=False)
    assert time.monotonic() - begin < 0.01


def test_points_from_a_second_thread_are_rejected(stream: Any) -> None:
    with ThreadPoolExecutor(1) as other:
        appending = other.submit(stream.append, there(0.1, 0.4))
        until(lambda: stream.end == 0.4)  # the other thread waits for room
        with pytest.raises(LocalError, match="only one may do so at once"):
            stream.append(there(0.1, 0.8))
        with pytest.raises(LocalError, match="only one may do so at once"):
            stream.replace(0.0, there(0.1, 0.8))
        stream.clear()  # allowed in any thread
        assert isinstance(appending.exception(), Cancelled)
    with pytest.raises(BadValue):
        stream.append([])
    stream.append(there(0.1, 0.4), wait=False)


def test_points_are_planned_again_after_a_concurrent_clear(
    stream: Any, feeds: list[Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    after, read = PointReader.after, list[float]()

    def clears(reader: PointReader, points: Any, mark: Any, begins: float) -> Sequence[Aim]:
        read.append(mark.time)
        if len(read) == 1:
            feeds[0].skip(2.0)  # an empty stream then has another end
        return after(reader, points, mark, begins)

    monkeypatch.setattr(PointReader, "after", clears)
    stream.append(there(0.04, 3.0), wait=False)
    assert read == [0.0, 2.0]
    assert stream.end == 3.0


def test_trajectory_of_several_arms_may_start_later(stream: Any) -> None:
    """Set the clock forward, because no points are left, and another arm still has points."""
    path = Trajectory.from_arrays([0, 1], [turned(0.0), turned(0.1)])
    other = MemberStream("other", [], end=4.0)
    grouped(stream, other).append([path, cast(Any, [5.0])], wait=False)
    assert (stream.time, stream.end) == (4.0, 5.0)
    other.end = 3.0
    grouped(stream, other).append([there(0.1, 6.0), cast(Any, [6.0])], wait=False)
    assert (stream.time, stream.end) == (4.0, 6.0)


def test_pose_is_reached_with_current_tool(stream: Any, feeds: list[Any]) -> None:
    q = turned(0.1)
    stream.append(PosePoint(Arm("UR5e").forward(q), 1.0), wait=False)
    assert feeds[0].mark.moment.q == pytest.approx(q, abs=1e-6)
    stream.replace(0.0, PosePoint(Arm("UR5e").forward(HOME), 1.0))
    assert feeds[0].mark.moment.q == pytest.approx(HOME, abs=1e-6)


def test_group_checks_a_change_before_it_is_made(stream: Any, feeds: list[Any]) -> None:
    """The change begins at the first time that can still be replaced after a hundredth of a second."""
    asked: list[tuple[Any, ...]] = []
    done: Future[float] = Future()
    done.set_result(1.5)

    def replace(since: float, curve: Sequence[Aim]) -> Future[float]:
        asked.append(("replace", since, curve))
        return done

    feeds[0].check = lambda *what: asked.append(("check", *what))
    feeds[0].reach = lambda later: later + 1.0
    feeds[0].replace = replace
    assert grouped(stream).clear() == 1.5
    assert asked == [("check", 1.01, ()), ("replace", 1.01, ())]


# -- its end -----------------------------------------------------------------------------------------------


def test_feed_ends_with_the_error_of_its_stream(robot: Rehearsal, stream: Any, feeds: list[Any]) -> None:
    ended: list[Exception] = []
    feeds[0].end = ended.append
    robot.vanish()
    robot.until(lambda: stream.done)
    assert isinstance(stream.error, ProgramStopped)
    assert [str(error) for error in ended] == [str(stream.error)]
    assert isinstance(ended[0], ProgramStopped)


def test_feed_ends_when_block_is_left(robot: Rehearsal, stream: Any, feeds: list[Any]) -> None:
    ended: list[Exception] = []
    feeds[0].end = ended.append
    assert robot.link is not None
    with ThreadPoolExecutor(1) as other, robot.link.makefile("rb") as messages:
        left = other.submit(stream.__exit__, None, None, None)
        while int.from_bytes(messages.read(4 * (MESSAGE + 1))[:4], "big") != STOP:
            pass
        robot.finish()
        left.result()
    assert isinstance(ended[0], Closed)
    assert "the block of this stream was left" in str(ended[0])


@pytest.mark.parametrize(
    ("why", "raised"), [(Cancelled("dropped"), ProgramStopped), (ValueError("not of the link"), ValueError)]
)
def test_call_raises_reason_of_end(
    robot: Rehearsal, stream: Any, feeds: list[Any], why: Exception, raised: type[Exception]
) -> None:
    """The stream ends while the call waits. Only an error of the link has the end of the stream as its reason."""
    failed: Future[float] = Future()
    feeds[0].replace = lambda since, curve: failed

    def end() -> None:
        robot.vanish()
        robot.until(lambda: stream.done)
        failed.set_exception(why)

    with ThreadPoolExecutor(1) as other:
        other.submit(end)
        with pytest.raises(raised):
            stream.clear()


def test_call_raises_error_of_its_points(stream: Any, feeds: list[Any]) -> None:
    failed: Future[float] = Future()
    failed.set_exception(Cancelled("dropped"))
    feeds[0].replace = lambda since, curve: failed
    with pytest.raises(Cancelled, match="dropped"):
        stream.clear()


def test_stream_joins_and_leaves_common_pace(robot: Rehearsal, feeds: list[Any]) -> None:
    left: list[int] = []
    pace = SimpleNamespace(is_paused=None, leave=lambda: left.append(1))
    stream = robot.motion.stream()
    stream._join(cast(MemberPace, pace))
    assert feeds[0].pace is pace
    assert cast(Any, pace).is_paused() is False
    stream.cancel()
    assert left == [1]

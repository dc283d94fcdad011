"""Stream of several arms, with fakes in place of the single streams: the calls to each, in order."""

from __future__ import annotations

import contextlib
import math
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future
from functools import partial
from types import SimpleNamespace
from typing import Any, cast

import pytest

from linkcore.errors import BadValue, Cancelled, ConnectionLost, LinkTimeout, LocalError
from linkcore.handle import Handle, Lifecycle, Phase
from linkcore.threads import CallbackThread
from urlink.motion.stream.group_motion import GroupStream
from urlink.motion.stream.point_stream import PointStream
from urlink.motion.stream.stream_points import Points


class Callbacks:
    """Run callbacks immediately and one after another, as a callback thread does."""

    def __init__(self) -> None:
        self._waiting: deque[Callable[[], object]] = deque()
        self._is_busy = False
        self.has_started = False

    def start(self) -> None:
        self.has_started = True

    def call(self, function: Callable[..., object], *arguments: Any) -> None:
        self._waiting.append(partial(function, *arguments))
        if not self._is_busy:
            self._is_busy = True
            while self._waiting:
                self._waiting.popleft()()
            self._is_busy = False


CALLBACKS = cast(CallbackThread, Callbacks())


class Stream(Handle):
    """Fake of a `PointStream`; all fakes record their `calls` in one list."""

    def __init__(self, name: str, calls: list[tuple[Any, ...]], *, end: float = 0.0) -> None:
        self.life = Lifecycle(name, CALLBACKS)
        super().__init__(self.life)
        self.life.begin()
        self._calls = calls
        self.arm = name
        self.time, self.end, self.room, self.starved, self.is_dry = 0.0, end, 0.3, 0, True
        self.reach = 0.0
        #: exception to raise, by the name of the call
        self.raises: dict[str, Exception] = {}
        self.is_cleared_meanwhile = False
        #: number of waits for an answer that end before all cuts are answered
        self.unanswered = 0
        self._program = SimpleNamespace(finish=lambda: self._called("finish"))

    def _called(self, *what: Any) -> None:
        self._calls.append((self.arm, *what))
        if what[0] in self.raises:
            raise self.raises[what[0]]

    def __enter__(self) -> Stream:
        self._called("enter")
        return self

    def __exit__(self, *exc: object) -> None:
        self._called("exit")
        self._life.finish()

    @contextlib.contextmanager
    def _producing(self) -> Iterator[None]:
        self._called("producing")
        yield

    def _check_open(self) -> None:
        self._called("open")

    def _mark(self) -> Any:
        return SimpleNamespace(time=self.end)

    def _checked(self, points: Sequence[float], begins: float) -> tuple[Any, list[Any]]:
        self._called("checked", begins)
        return "mark", [SimpleNamespace(time=time) for time in points]

    def _add(self, mark: Any, aims: Sequence[Any]) -> object | None:
        if self.is_cleared_meanwhile:
            self.is_cleared_meanwhile = False
            return None
        self._called("add", mark, [aim.time for aim in aims])
        self.end = aims[-1].time
        return f"points of {self.arm}"

    def _await_room(self, handed: object, seconds: float) -> None:
        self._called("room", handed, math.ceil(seconds))

    def _curve(self, points: Sequence[float], since: float) -> list[Any]:
        self._called("curve", since)
        return [SimpleNamespace(time=time) for time in points]

    def _await_answer(self) -> None:
        self._called("answer")
        self.unanswered -= 1

    @property
    def _is_answered(self) -> bool:
        return self.unanswered <= 0

    def _reach(self, later: float) -> float:
        self._called("reach", later)
        return self.reach

    def _check(self, since: float, curve: Sequence[Any]) -> None:
        self._called("check", since)

    def _put(self, since: float, curve: Sequence[Any]) -> Future[float]:
        self._called("put", since, len(curve))
        replaced: Future[float] = Future()
        replaced.set_result(since + self.reach / 100.0)
        return replaced

    def _answered(self, replaced: Future[float]) -> float:
        self._called("answered")
        return replaced.result()

    def wait_until_dry(self, timeout: float) -> None:
        self._called("dry", math.ceil(timeout))


class Streams:
    """Streams of a left and a right arm."""

    def __init__(self) -> None:
        self.calls: list[tuple[Any, ...]] = []
        self.left, self.right = Stream("left", self.calls), Stream("right", self.calls, end=0.5)
        streams = cast("list[PointStream]", [self.left, self.right])
        self.life = Lifecycle("streams", CALLBACKS)
        self.group = GroupStream(self.life, streams, ["left", "right"], CALLBACKS)

    def append(self, *ends: Sequence[float], wait: bool | float = True) -> float:
        """Append points, which are given by their times."""
        return self.group.append(cast("list[Points]", ends), wait=wait)

    def replace(self, since: float, *ends: Sequence[float]) -> float:
        return self.group.replace(since, cast("list[Points]", ends))

    def called(self, name: str) -> list[tuple[Any, ...]]:
        return [(arm, *rest) for arm, what, *rest in self.calls if what == name]


@pytest.fixture
def streams() -> Streams:
    return Streams()


def test_block_enters_and_leaves_all_streams(streams: Streams) -> None:
    with streams.group as group:
        assert group.phase is Phase.RUNNING
        assert streams.calls == [("left", "enter"), ("right", "enter")]
        streams.calls.clear()
    # Both streams start to brake before the block waits for either of them.
    assert streams.calls == [("left", "finish"), ("right", "finish"), ("right", "exit"), ("left", "exit")]
    assert streams.group.phase is Phase.DONE


def test_failed_start_of_one_stream_leaves_the_others(streams: Streams) -> None:
    streams.right.raises["enter"] = ConnectionLost("no way")
    with pytest.raises(ConnectionLost), streams.group:
        pass
    assert streams.calls == [("left", "enter"), ("right", "enter"), ("left", "exit")]
    assert isinstance(streams.group.error, ConnectionLost)


def test_interrupt_during_start_cancels_group(streams: Streams) -> None:
    streams.right.raises["enter"] = cast(Exception, KeyboardInterrupt())
    with pytest.raises(KeyboardInterrupt), streams.group:
        pass
    assert isinstance(streams.group.error, Cancelled)
    assert "was interrupted" in str(streams.group.error)


def test_failing_stream_does_not_keep_others_from_braking(streams: Streams) -> None:
    streams.left.raises["finish"] = ConnectionLost("no way")
    with streams.group:
        pass
    assert streams.called("finish") == [("left",), ("right",)]
    assert streams.called("exit") == [("right",), ("left",)]


def test_group_points_start_at_the_latest_arm_and_reach_all_arms(streams: Streams) -> None:
    streams.left.room = 0.1
    assert streams.append([1.0, 2.0], [1.5, 2.0], wait=20.0) == 0.1
    assert streams.called("checked") == [("left", 0.5), ("right", 0.5)]
    assert streams.called("add") == [("left", "mark", [1.0, 2.0]), ("right", "mark", [1.5, 2.0])]
    assert streams.called("room") == [("left", "points of left", 20), ("right", "points of right", 20)]
    streams.calls.clear()
    streams.append([3.0], [3.0], wait=False)
    assert streams.called("room") == []
    assert streams.called("producing") == [("left",), ("right",)]


def test_group_points_are_checked_again_after_concurrent_clear(streams: Streams) -> None:
    streams.left.is_cleared_meanwhile = streams.right.is_cleared_meanwhile = True
    streams.append([1.0], [1.0])
    assert len(streams.called("checked")) == 4
    assert [arm for arm, *_ in streams.called("add")] == ["left", "right"]


@pytest.mark.parametrize(("ends", "is_refused"), [(1.0 + 0.9e-6, False), (1.0 + 1.1e-6, True)])
def test_points_that_end_at_different_times_are_rejected(streams: Streams, ends: float, is_refused: bool) -> None:
    calls: list[Callable[[], object]] = [
        lambda: streams.append([1.0], [ends]),
        lambda: streams.replace(0.1, [1.0], [ends]),
    ]
    for call in calls:
        streams.calls.clear()
        with pytest.raises(BadValue, match="the points end at 1, 1 s") if is_refused else contextlib.nullcontext():
            call()
        assert bool(streams.called("add") or streams.called("put")) is not is_refused


@pytest.mark.parametrize("count", [0, 1, 3])
def test_append_requires_points_for_each_arm(streams: Streams, count: int) -> None:
    with pytest.raises(BadValue, match=f"^points has entries for {count} arms; expected one for each of the 2$"):
        streams.append(*[[1.0]] * count)
    assert streams.calls == []


@pytest.mark.parametrize(("since", "begin"), [(0.1, 0.8), (0.9, 0.9)])
def test_replacement_starts_at_one_time_for_all_arms(streams: Streams, since: float, begin: float) -> None:
    streams.left.reach, streams.right.reach = 0.7, 0.8
    assert streams.replace(since, [1.0, 2.0], [2.0]) == pytest.approx(begin + 0.008)
    assert streams.called("curve") == [("left", since), ("right", since)]
    assert streams.called("reach") == [("left", 0.01), ("right", 0.01)]
    assert streams.called("check") == [("left", begin), ("right", begin)]
    assert streams.called("put") == [("left", begin, 2), ("right", begin, 1)]


def test_replace_waits_until_all_streams_have_answered(streams: Streams) -> None:
    streams.right.unanswered = 2
    streams.replace(0.1, [1.0], [1.0])
    assert len(streams.called("answer")) == 4
    assert len(streams.called("put")) == 2


def test_rejected_check_keeps_points_of_all_arms(streams: Streams) -> None:
    streams.right.raises["check"] = BadValue("too far")
    with pytest.raises(BadValue, match=r"^too far$"):
        streams.replace(0.1, [1.0], [1.0])
    assert streams.called("put") == []


def test_late_rejection_by_one_arm_clears_all_arms(streams: Streams) -> None:
    streams.right.raises["answered"] = BadValue("too far by now")
    clear = streams.group.clear
    cleared: list[int] = []

    def clears() -> float:
        cleared.append(1)
        streams.right.raises.clear()
        return clear()

    streams.group.clear = clears  # type: ignore[method-assign]
    late = r"^all points of all arms were cleared, because the change reached right too late: too far by now$"
    with pytest.raises(BadValue, match=late) as caught:
        streams.replace(0.1, [1.0], [1.0])
    assert isinstance(caught.value.__cause__, BadValue)
    assert cleared == [1]
    assert streams.called("put")[2:] == [("left", 0.0, 0), ("right", 0.0, 0)]


def test_late_rejection_by_all_arms_keeps_points(streams: Streams) -> None:
    streams.left.raises["answered"] = BadValue("too far by now")
    streams.right.raises["answered"] = BadValue("and here")
    with pytest.raises(BadValue, match=r"^too far by now$"):
        streams.replace(0.1, [1.0], [1.0])
    assert len(streams.called("put")) == 2


def test_clear_uses_one_time_for_all_arms(streams: Streams) -> None:
    streams.left.reach, streams.right.reach = 0.7, 0.6
    assert streams.group.clear() == pytest.approx(0.707)
    assert streams.called("open") == [("left",), ("right",)]
    assert streams.called("put") == [("left", 0.7, 0), ("right", 0.7, 0)]


def test_group_is_dry_when_all_streams_are_dry(streams: Streams) -> None:
    streams.group.wait_until_dry(7.0)
    assert streams.called("dry") == [("left", 7), ("right", 7)]
    seen = [streams.group.is_dry]
    streams.right.is_dry = False
    assert [*seen, streams.group.is_dry] == [True, False]
    with pytest.raises(BadValue):
        streams.group.wait_until_dry(math.inf)


def test_properties_combine_all_streams(streams: Streams) -> None:
    """The group reports the earliest time, the smallest room, the latest end and the largest starved count."""
    group, left, right = streams.group, streams.left, streams.right
    left.time, right.time, left.end, right.end = 0.3, 0.2, 1.0, 1.5
    left.room, right.room, left.starved, right.starved = 0.1, -0.2, 1, 3
    assert (group.time, group.end, group.room, group.starved) == (0.2, 1.5, -0.2, 3)
    assert group.buffered == pytest.approx(1.3)
    left.time = right.time = 2.0
    assert group.buffered == 0.0


def test_failed_stream_fails_group_and_cancels_others(streams: Streams) -> None:
    with streams.group:
        streams.right.life.fail(ConnectionLost("stream lost"))
        assert streams.left.phase is Phase.CANCELLED
        streams.left.raises["producing"] = Cancelled("the stream was cancelled")
        with pytest.raises(ConnectionLost, match="stream lost"):
            streams.append([1.0], [1.0])


@pytest.mark.parametrize("ended", ["group", "left"])
def test_cancelling_one_stream_cancels_all(streams: Streams, ended: str) -> None:
    with contextlib.suppress(Cancelled), streams.group:
        (streams.group if ended == "group" else streams.left).cancel()
    for each in (streams.group, streams.left, streams.right):
        assert each.phase is Phase.CANCELLED
    why = "streams was cancelled" if ended == "group" else "cancelled with the motion of left: left was cancelled"
    assert why in str(streams.group.error)


def test_error_of_call_does_not_end_group(streams: Streams) -> None:
    with streams.group:
        streams.left.raises["dry"] = LinkTimeout("it has not run dry")
        with pytest.raises(LinkTimeout):
            streams.group.wait_until_dry(1.0)
        assert not streams.group.done


def test_group_waits_for_reason_when_a_stream_has_ended(streams: Streams, monkeypatch: pytest.MonkeyPatch) -> None:
    """Another thread reports the reason. If a call fails but no stream has ended, there is no wait."""
    waited: list[float] = []

    def wait(timeout: float) -> bool:
        waited.append(timeout)
        return True

    monkeypatch.setattr(streams.life, "wait", wait)
    with streams.group:
        streams.left.raises["open"] = LocalError("not within its block")
        with pytest.raises(LocalError):
            streams.group.clear()
        assert waited == []
        monkeypatch.setattr(Stream, "done", property(lambda stream: stream is streams.right))
        with pytest.raises(LocalError):
            streams.group.clear()
        assert waited == [1.0]
    assert waited == [1.0, 1.0]


def test_ended_stream_is_not_cleared(streams: Streams, monkeypatch: pytest.MonkeyPatch) -> None:
    def over() -> Any:
        raise ConnectionLost("stream lost")

    monkeypatch.setattr(streams.right, "_mark", over)
    with pytest.raises(ConnectionLost, match="stream lost"):
        streams.group.clear()
    assert streams.called("put") == []


def test_waits_for_all_arms_share_one_timeout(streams: Streams, monkeypatch: pytest.MonkeyPatch) -> None:
    now = [100.0]
    monkeypatch.setattr(
        "urlink.motion.stream.group_motion.clock",
        SimpleNamespace(now=lambda: now[0], left=lambda until: max(until - now[0], 0.0)),
    )
    monkeypatch.setattr(streams.left, "_await_room", lambda handed, seconds: now.__setitem__(0, now[0] + 45.0))
    streams.group.append(cast("list[Points]", [[1.0], [1.0]]))
    streams.group.append(cast("list[Points]", [[2.0], [2.0]]), wait=30.0)
    assert [seconds for _, _, seconds in streams.called("room")] == [15, 0]
    monkeypatch.setattr(streams.left, "wait_until_dry", lambda seconds: now.__setitem__(0, now[0] + 45.0))
    streams.group.wait_until_dry()
    streams.group.wait_until_dry(30.0)
    assert streams.called("dry") == [("right", 15), ("right", 0)]

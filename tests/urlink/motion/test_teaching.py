"""Waypoints that are taught by hand, saved in files, and played."""

from __future__ import annotations

import contextlib
import json
import re
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import urlink
from linkcore.errors import BadValue, Cancelled, LocalError
from tests.waiting import until
from urlink import Joint, Taught
from urlink.errors import SafetyStop
from urlink.motion import TaughtPoint, Teaching
from urlink.protocol.enums import RobotStatusBits
from urlink.robot import Robot
from urlink.simulator import Controller, Still

pytestmark = pytest.mark.simulated_time

TIMEOUT = 120.0
SIX = st.tuples(*[st.floats(-10, 10)] * 6)


@pytest.fixture
def arm() -> Iterator[tuple[Controller, Robot]]:
    with (
        Controller("UR5e", "5.11", motion=Still()) as controller,
        urlink.connect(controller.address, stale_after=20.0, silence=30.0) as robot,
    ):
        yield controller, robot


def has_come_to(controller: Controller, cycle: int) -> bool:
    return controller.cycle > cycle


def has(taught: Taught, count: int) -> bool:
    return len(taught) == count


def pushed(controller: Controller) -> None:
    """Lift the tool by two millimetres by hand, and release it."""
    at = controller.arm.setpoint.q
    controller.push([0, 0, 20.0, 0, 0, 0])
    until(lambda: np.abs(np.subtract(controller.arm.setpoint.q, at)).max() > 2e-3, TIMEOUT)
    controller.push([0.0] * 6)
    until(lambda: not any(controller.arm.setpoint.qd), TIMEOUT)


@pytest.mark.slow
def test_taught_waypoints_are_saved_and_played(arm: tuple[Controller, Robot], tmp_path: Path) -> None:
    controller, robot = arm
    reported: list[TaughtPoint] = []
    # An input that is already on records nothing.
    controller.signals.set_digital_input(2, True)
    with robot.teach(digital_input=2, on_point=reported.append, watchdog=2.0) as teaching:
        first = teaching.record()
        assert first.q == pytest.approx(controller.arm.setpoint.q, abs=1e-3)
        pushed(controller)
        controller.signals.set_digital_input(2, False)
        until(lambda: not robot.realtime.wait(5).digital_input_bits & 4)
        controller.signals.set_digital_input(2, True)
        until(lambda: len(teaching.taught) == 2, TIMEOUT)
    assert reported == list(teaching.taught)
    assert teaching.taught.model == "UR5e"
    with pytest.raises(LocalError, match="the block is not open"):
        teaching.record()
    file = tmp_path / "taught.json"
    teaching.taught.save(file)
    taught = Taught.load(file)
    taught.play(robot, speed=1.0, acceleration=3.0, wait=TIMEOUT)
    assert robot.realtime.wait(5).q_actual == pytest.approx(reported[1].q, abs=1e-3)
    controller.faults.protective_stop()
    until(lambda: robot.safety.refusal is not None)
    with pytest.raises(SafetyStop):
        taught.play(robot)


@pytest.mark.slow
def test_button_records_on_release_without_program(arm: tuple[Controller, Robot]) -> None:
    controller, robot = arm
    with robot.teach(button=True) as teaching:
        assert teaching.freedrive is None
        for count in (1, 2):
            for is_held in (True, False):
                controller.teach_button = is_held
                until(partial(has_come_to, controller, controller.cycle + 60))
            until(partial(has, teaching.taught, count), TIMEOUT)
        assert controller.program_name is None


class Said:
    """Stream of states that the test sends; `closed` lists its closed parts."""

    def __init__(self, closed: list[str], name: str) -> None:
        self._closed, self._name = closed, name
        self._callback: Callable[[Any], object] | None = None
        self._newest: Any = None

    def subscribe(self, callback: Callable[[Any], object]) -> Any:
        self._callback = callback
        return SimpleNamespace(close=lambda: self._closed.append(f"subscription of {self._name}"))

    def wait(self) -> Any:
        return self._newest

    def close(self) -> None:
        self._closed.append(self._name)

    def send_state(self, x: float = 0.0, time: float = 0.0, inputs: int = 0, status: int = 0) -> None:
        """Send a state with the arm at `x` in all numbers."""
        self._newest = SimpleNamespace(
            time=time,
            q_actual=[x] * 6,
            tool_vector_actual=[-x] * 6,
            digital_input_bits=inputs,
            robot_status_bits=status,
        )
        if self._callback is not None:
            self._callback(self._newest)


class Mode:
    """Fake freedrive that records its start and its end."""

    def __init__(self, ended: list[str]) -> None:
        self.error: Exception | None = None
        self._ended = ended

    def __enter__(self) -> None:
        self._ended.append("begun")

    def __exit__(self, *exc: object) -> None:
        self._ended.append("freedrive")


def teaching_with(
    realtime: Said, mode: Mode | None = None, input_bit: int | None = None, buttons: Said | None = None
) -> tuple[Teaching, list[TaughtPoint]]:
    reported: list[TaughtPoint] = []
    said, freedrive, released = cast("Any", realtime), cast("Any", mode), cast("Any", buttons)
    return Teaching(said, "UR5e", freedrive, input_bit, released, reported.append), reported


def test_input_records_when_switched_on_without_bounce() -> None:
    closed: list[str] = []
    realtime = Said(closed, "realtime")
    teaching, reported = teaching_with(realtime, input_bit=3)
    with teaching:
        # The input is on from the start, then other inputs are on, then this input together with others.
        for x, time, inputs in (
            (1, -0.3, 0b1000),
            (2, -0.2, 0),
            (3, -0.1, 0b10111),
            (4, 0.0, 0b11001),
            (5, 0.1, 0b1000),
        ):
            realtime.send_state(x, time, inputs)
        assert [point.q[0] for point in reported] == [4]
        for x, time, inputs in ((6, 0.15, 0), (7, 0.2, 0b1000), (8, 0.25, 0), (9, 0.3, 0b1000), (10, 0.6, 0)):
            realtime.send_state(x, time, inputs)
    assert closed == ["subscription of realtime"]
    assert [(point.q.tolist(), point.pose.tolist()) for point in reported] == [([x] * 6, [-x] * 6) for x in (4, 9)]
    assert list(teaching.taught) == reported
    assert teaching.taught.model == "UR5e"


def test_button_records_position_on_release() -> None:
    closed: list[str] = []
    realtime, buttons = Said(closed, "realtime"), Said(closed, "buttons")
    teaching, reported = teaching_with(realtime, buttons=buttons)
    with teaching:
        held = RobotStatusBits.POWER_ON | RobotStatusBits.TEACH_BUTTON_PRESSED
        for x, status in enumerate((RobotStatusBits.POWER_ON, held, held, RobotStatusBits.POWER_ON, held, 0, 0)):
            realtime.send_state(x)
            buttons.send_state(9, status=status)
    assert [point.q[0] for point in reported] == [3, 5]
    assert closed == ["subscription of buttons", "buttons"]


def test_recording_requires_open_block_and_mode() -> None:
    ended: list[str] = []
    realtime, mode = Said(ended, "realtime"), Mode(ended)
    teaching, reported = teaching_with(realtime, mode)
    assert cast("Any", teaching.freedrive) is mode
    realtime.send_state(0.5)
    with pytest.raises(LocalError, match="the block is not open"):
        teaching.record()
    with teaching as entered:
        assert entered is teaching
        assert ended == ["begun"]
        point = teaching.record()
        assert point.q.tolist() == [0.5] * 6
        mode.error = Cancelled("freedrive was cancelled")
        with pytest.raises(Cancelled, match="was cancelled"):
            teaching.record()
    assert ended == ["begun", "freedrive"]
    mode.error = None
    with pytest.raises(LocalError, match="the block is not open"):
        teaching.record()
    assert reported == [point] == list(teaching.taught)


def test_failed_subscription_ends_mode() -> None:
    ended: list[str] = []
    buttons = Said(ended, "buttons")
    buttons.subscribe = None  # type: ignore[assignment,method-assign]
    teaching, _ = teaching_with(Said(ended, "realtime"), Mode(ended), 0, buttons)
    with pytest.raises(TypeError), teaching:
        pass
    assert ended == ["begun", "buttons", "subscription of realtime", "freedrive"]
    with pytest.raises(LocalError, match="the block is not open"):
        teaching.record()


@pytest.mark.slow
def test_cancelled_mode_records_nothing(arm: tuple[Controller, Robot]) -> None:
    _, robot = arm
    with robot.teach(watchdog=2.0) as teaching:
        assert teaching.freedrive is not None
        teaching.freedrive.cancel()
        with pytest.raises(Cancelled):
            teaching.record()
    assert len(teaching.taught) == 0


@pytest.mark.property
@given(points=st.lists(st.tuples(SIX, SIX), max_size=5), model=st.none() | st.text(max_size=5))
def test_saved_file_is_loaded_unchanged(
    tmp_path_factory: pytest.TempPathFactory, points: list[tuple[tuple[float, ...], ...]], model: str | None
) -> None:
    file = tmp_path_factory.mktemp("taught") / "a.json"
    Taught([TaughtPoint(np.array(q), np.array(pose)) for q, pose in points], model).save(file)
    loaded = Taught.load(file)
    assert loaded.model == model
    assert [(tuple(point.q), tuple(point.pose)) for point in loaded] == points
    assert list(file.parent.iterdir()) == [file]


JSON = st.recursive(
    st.none() | st.booleans() | st.floats() | st.text(max_size=3),
    lambda inner: (
        st.lists(inner, max_size=3)
        | st.dictionaries(st.sampled_from(["format", "version", "model", "waypoints", "q", "pose"]), inner)
    ),
    max_leaves=8,
)


@pytest.mark.property
@given(
    held=JSON
    | st.builds(
        lambda waypoints, model: {
            "format": "urlink taught waypoints",
            "version": 1,
            "model": model,
            "waypoints": waypoints,
        },
        JSON,
        JSON,
    )
)
def test_other_files_are_rejected(tmp_path_factory: pytest.TempPathFactory, held: Any) -> None:
    file = tmp_path_factory.mktemp("taught") / "a.json"
    file.write_text(json.dumps(held))
    with contextlib.suppress(BadValue):
        assert all(np.isfinite(point.q).all() for point in Taught.load(file))


def test_play_follows_one_path_through_all_joints() -> None:
    """Its defaults are no wait, a slow motion, and a stop at each waypoint."""
    asked: list[tuple[list[Joint], dict[str, object]]] = []
    handle = object()

    def path(waypoints: list[Joint], **rates: object) -> object:
        asked.append((waypoints, rates))
        return handle

    robot = cast("Any", SimpleNamespace(model="UR5e", motion=SimpleNamespace(path=path)))
    taught = Taught([TaughtPoint(np.full(6, 0.1 * i), np.zeros(6)) for i in range(3)])
    assert taught.play(robot) is handle
    assert taught.play(robot, speed=0.2, acceleration=0.3, blend=0.01, wait=5.0) is handle
    for (waypoints, rates), blends, expected in zip(
        asked, ([0.0] * 3, [0.01, 0.01, 0.0]), ((0.5, 1.0, False), (0.2, 0.3, 5.0)), strict=True
    ):
        assert [each.q.tolist() for each in waypoints] == [[0.1 * i] * 6 for i in range(3)]
        assert [each.blend for each in waypoints] == blends
        assert rates == dict(zip(("joint_speed", "joint_acceleration", "wait"), expected, strict=True))
    assert [each.blend for each in taught.waypoints()] == [0.0] * 3


def test_files_of_first_release_can_be_read(tmp_path: Path) -> None:
    file = tmp_path / "a.json"
    point = {"q": [1, 2, 3, 4, 5, 6], "pose": [0.1] * 6}
    file.write_text(
        json.dumps({"format": "urlink taught waypoints", "version": 1, "model": None, "waypoints": [point]})
    )
    assert [each.q.tolist() for each in Taught.load(file)] == [point["q"]]


POINT = {"q": [0] * 6, "pose": [0] * 6}


@pytest.mark.parametrize(
    ("held", "message"),
    [
        ([], 'expected an object whose "format" is "urlink taught waypoints"'),
        ({"format": "poses"}, "expected an object"),
        ({"version": 2}, "unknown version 2; expected 1"),
        ({"model": 5}, '"model" is 5; expected a name or null'),
        ({"waypoints": {}}, '"waypoints" must be a list'),
        ({"waypoints": [POINT, [0] * 6]}, 'waypoint 1 has no "q" and "pose"'),
        ({"waypoints": [{"q": [0] * 6}]}, 'waypoint 0 has no "q" and "pose"'),
        ({"waypoints": [{**POINT, "q": [0] * 5}]}, "q of waypoint 0 has the shape"),
        ({"waypoints": [{**POINT, "pose": "here"}]}, "its pose is 'here'; expected numbers"),
    ],
)
def test_error_describes_invalid_file(tmp_path: Path, held: object, message: str) -> None:
    file = tmp_path / "a.json"
    if isinstance(held, dict):
        held = {"format": "urlink taught waypoints", "version": 1, "model": None, "waypoints": [], **held}
    file.write_text(json.dumps(held))
    with pytest.raises(BadValue, match=f"{re.escape(str(file))}: {message}"):
        Taught.load(file)


def test_impossible_calls_are_rejected(tmp_path: Path) -> None:
    point = TaughtPoint(np.zeros(6), np.zeros(6))
    other = cast("Any", SimpleNamespace(model="UR10e", motion=None))
    with pytest.raises(BadValue, match="nothing to play"):
        Taught().play(other)
    with pytest.raises(BadValue, match="taught on a UR5e, but this is a UR10e"):
        Taught([point], "UR5e").play(other)
    with pytest.raises(BadValue, match="no waypoint was taught yet"):
        Taught().remove_last()
    taught = Taught([point, point])
    assert taught.remove_last() is point
    assert len(taught) == 1
    with pytest.raises(BadValue, match="cannot write"):
        taught.save(tmp_path / "none" / "a.json")
    with pytest.raises(BadValue, match=re.escape(f"cannot write {tmp_path}")):
        taught.save(tmp_path)
    assert list(tmp_path.parent.glob(f".{tmp_path.name}*")) == []
    with pytest.raises(BadValue, match="cannot read"):
        Taught.load(tmp_path / "none.json")
    (tmp_path / "text").write_text("{")
    with pytest.raises(BadValue, match="is not a JSON file"):
        Taught.load(tmp_path / "text")

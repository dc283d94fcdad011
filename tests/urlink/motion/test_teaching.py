"""Waypoints that are taught by hand, kept in files, and played."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Iterator
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
from urlink.errors import SafetyStop
from urlink.motion import Taught, TaughtPoint
from urlink.robot import Robot
from urlink.simulator import Controller, Still

TIMEOUT = 30.0
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
    """A hand that lifts the tool by two millimetres, and lets go."""
    at = controller.arm.setpoint.q
    controller.push([0, 0, 20.0, 0, 0, 0])
    until(lambda: np.abs(np.subtract(controller.arm.setpoint.q, at)).max() > 2e-3, TIMEOUT)
    controller.push([0.0] * 6)
    until(lambda: not any(controller.arm.setpoint.qd), TIMEOUT)


@pytest.mark.slow
def test_waypoints_by_calls_and_by_an_input_are_saved_and_played(arm: tuple[Controller, Robot], tmp_path: Path) -> None:
    controller, robot = arm
    told: list[TaughtPoint] = []
    # An input that is on already keeps nothing.
    controller.signals.set_digital_input(2, True)
    with robot.teach(digital_input=2, on_point=told.append, watchdog=2.0) as teaching:
        first = teaching.record()
        assert first.q == pytest.approx(controller.arm.setpoint.q, abs=1e-3)
        pushed(controller)
        controller.signals.set_digital_input(2, False)
        until(lambda: not robot.realtime.wait(5).digital_input_bits & 4)
        controller.signals.set_digital_input(2, True)
        until(lambda: len(teaching.taught) == 2, TIMEOUT)
    assert told == list(teaching.taught)
    assert teaching.taught.model == "UR5e"
    with pytest.raises(LocalError, match="within the block"):
        teaching.record()
    file = tmp_path / "taught.json"
    teaching.taught.save(file)
    taught = Taught.load(file)
    taught.play(robot, speed=1.0, acceleration=3.0, wait=TIMEOUT)
    assert robot.realtime.wait(5).q_actual == pytest.approx(told[1].q, abs=1e-3)
    controller.faults.protective_stop()
    until(lambda: robot.safety.refusal is not None)
    with pytest.raises(SafetyStop):
        taught.play(robot)


@pytest.mark.slow
def test_the_button_keeps_one_when_it_is_let_go_and_no_program_runs(arm: tuple[Controller, Robot]) -> None:
    controller, robot = arm
    with robot.teach(button=True) as teaching:
        assert teaching.freedrive is None
        for count in (1, 2):
            for is_held in (True, False):
                controller.teach_button = is_held
                until(partial(has_come_to, controller, controller.cycle + 60))
            until(partial(has, teaching.taught, count), TIMEOUT)
        assert controller.program_name is None


@pytest.mark.slow
def test_a_mode_that_is_over_records_nothing(arm: tuple[Controller, Robot]) -> None:
    _, robot = arm
    with robot.teach(watchdog=2.0) as teaching:
        assert teaching.freedrive is not None
        teaching.freedrive.cancel()
        with pytest.raises(Cancelled):
            teaching.record()
    assert len(teaching.taught) == 0


@pytest.mark.property
@given(points=st.lists(st.tuples(SIX, SIX), max_size=5), model=st.none() | st.text(max_size=5))
def test_what_was_saved_is_loaded(
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
def test_what_is_something_else_is_refused(tmp_path_factory: pytest.TempPathFactory, held: Any) -> None:
    file = tmp_path_factory.mktemp("taught") / "a.json"
    file.write_text(json.dumps(held))
    with contextlib.suppress(BadValue):
        assert all(np.isfinite(point.q).all() for point in Taught.load(file))


def test_what_cannot_be_played_or_kept_is_refused(tmp_path: Path) -> None:
    point = TaughtPoint(np.zeros(6), np.zeros(6))
    other = cast("Any", SimpleNamespace(model="UR10e", motion=None))
    with pytest.raises(BadValue, match="nothing to play"):
        Taught().play(other)
    with pytest.raises(BadValue, match="taught on a UR5e, and this is a UR10e"):
        Taught([point], "UR5e").play(other)
    with pytest.raises(BadValue, match="no waypoint was taught yet"):
        Taught().remove_last()
    taught = Taught([point, point])
    assert taught.remove_last() is point
    assert len(taught) == 1
    with pytest.raises(BadValue, match="cannot write"):
        taught.save(tmp_path / "none" / "a.json")
    with pytest.raises(BadValue, match="cannot read"):
        Taught.load(tmp_path / "none.json")
    (tmp_path / "text").write_text("{")
    with pytest.raises(BadValue, match="is no JSON"):
        Taught.load(tmp_path / "text")
    assert [each.blend for each in Taught([point] * 3).waypoints(0.01)] == [0.01, 0.01, 0.0]

"""Stage 2 on simulated controllers: a sound controller passes, and no fault makes an arm leave the box."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import pytest

from packages.accept.tests.acceptance.faulted import faulted, tried
from urlink.simulator import Controller
from urlink_accept.acceptance.evidence import Evidence
from urlink_accept.acceptance.logbook import Logbook
from urlink_accept.acceptance.person import OfTheSimulator
from urlink_accept.acceptance.report import judge
from urlink_accept.acceptance.requirements import requirements
from urlink_accept.acceptance.stages import run
from urlink_accept.acceptance.standing import Told, try_each

LIMIT = requirements()["box"].limit


def consent(number: int, does: str) -> str:
    return ""


@pytest.mark.slow
@pytest.mark.simulated_time
def test_correct_controller_meets_all_requirements(tmp_path: Path) -> None:
    path = tmp_path / "run.urlog"
    run("sim://?firmware=3.15", path, (2,), consent)
    verdicts = {each.requirement.name: each for each in judge(Evidence(path), requirements())}
    moved = [each for each in verdicts.values() if each.requirement.stage == 2]
    assert {each.requirement.name: each.seen for each in moved if each.state == "not held"} == {}
    assert [each.requirement.name for each in moved if each.state == "not tried"] == ["frozen"]


@pytest.mark.slow
@pytest.mark.simulated_time
def test_request_missing_in_firmware_is_reported_as_not_tried(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The Robot API of 10.7 has no pause."""

    def some(book: Logbook, steps: Mapping[str, Callable[[], Told]], between: Callable[[], object]) -> None:
        try_each(book, {name: steps[name] for name in ("move", "pause", "stop")}, between)

    monkeypatch.setattr("urlink_accept.acceptance.moving.try_each", some)
    run("sim://ur5e?firmware=10.7", tmp_path / "run.urlog", (2,), consent)
    verdicts = {each.requirement.name: each for each in judge(Evidence(tmp_path / "run.urlog"), requirements())}
    assert "the Robot API has 'pause' in 10.11 or later" in verdicts["pause"].seen
    assert {name: verdicts[name].state for name in ("move-arrives", "pause", "stop", "box")} == {
        "move-arrives": "held",
        "pause": "not tried",
        "stop": "held",
        "box": "held",
    }


class LetsGo(OfTheSimulator):
    """Person who holds the key for a given number of checks."""

    def __init__(self, controller: Controller, looks: int) -> None:
        super().__init__(controller)
        self._left = looks

    def holds(self) -> bool:
        self._left -= 1
        return self._left > 0


@pytest.mark.slow
@pytest.mark.simulated_time
def test_releasing_key_stops_arm(tmp_path: Path) -> None:
    with Controller("UR5", "3.15") as controller:
        ended = tried(controller, tmp_path / "run.urlog", LetsGo(controller, 200))
        assert ended == "stopped: the dead-man switch was released"
        assert np.abs(controller.arm.sample.qd_target).max() < 1e-3
    assert Evidence(tmp_path / "run.urlog").last("guard") is not None


@pytest.mark.simulated_time
def test_arm_does_not_move_before_input_is_held(tmp_path: Path) -> None:
    with Controller("UR5", "3.15") as controller:
        before = np.array(controller.arm.sample.q_target)
        assert "not held" in tried(controller, tmp_path / "run.urlog", OfTheSimulator(controller), dead_man=3)
        assert (np.array(controller.arm.sample.q_target) == before).all()


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 9, *(pytest.param(seed, marks=pytest.mark.matrix(9)) for seed in range(20, 38))])
def test_arm_stays_in_box_during_faults(seed: int, tmp_path: Path) -> None:
    ran = faulted(seed, 8.0, tmp_path)
    assert ran.happened.total() > 3
    assert 0.0 < ran.away <= LIMIT, ran

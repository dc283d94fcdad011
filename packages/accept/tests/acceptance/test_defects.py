"""The right requirement detects each planted defect."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest

import urlink
from packages.accept.tests.acceptance.defects import DEFECTS, planted
from urlink_accept.acceptance.evidence import Evidence, Note
from urlink_accept.acceptance.report import CHECKS, judge
from urlink_accept.acceptance.requirements import requirements
from urlink_accept.acceptance.stages import run


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> dict[bool, Evidence]:
    """Three seconds of a sound arm at rest, and of a moving arm."""
    found = {}
    for moves in (False, True):
        path: Path = tmp_path_factory.mktemp("sound") / "run.urlog"
        address = "sim://ur5e?firmware=5.11" + "&motion=demo" * moves
        with urlink.simulated_time(seed=3):
            run(address, path, (0,), lambda number, does: "", seconds=3.0)
        found[moves] = Evidence(path)
    return found


def test_sixty_defects_exist_and_name_existing_checks() -> None:
    assert len(DEFECTS) >= 60
    assert {each.named for each in DEFECTS.values()} <= CHECKS.keys()


@pytest.mark.matrix(3)
@pytest.mark.parametrize("name", DEFECTS)
def test_requirement_detects_planted_defect(sound: dict[bool, Evidence], name: str) -> None:
    defect = DEFECTS[name]
    # The other requirements may be held or not held.
    named = {defect.named: requirements()[defect.named]}
    (verdict,) = judge(planted(sound[defect.moves], defect), named)
    assert verdict.state == "not held", verdict
    assert defect.said in verdict.seen


@pytest.mark.slow
@pytest.mark.parametrize("moves", [False, True])
def test_judge_finds_no_failed_requirement_without_defects(sound: dict[bool, Evidence], moves: bool) -> None:
    """The shared evidence is not changed by planting."""
    assert [each.seen for each in judge(planted(sound[moves], None), requirements()) if each.state == "not held"] == []


def test_primary_rate_is_not_judged_when_computer_was_delayed(sound: dict[bool, Evidence]) -> None:
    """On a busy or slow computer, a simulated controller leaves out packages."""
    evidence = planted(sound[False], DEFECTS["robot states left out"])
    evidence.notes = [Note(at, step, {"worst": 0.2} if step == "woken" else said) for at, step, said in evidence.notes]
    (verdict,) = judge(evidence, {"primary-rate": requirements()["primary-rate"]})
    assert (verdict.state, verdict.seen[:33]) == ("not tried", "this computer itself was delayed ")


def test_rate_counts_only_time_after_listening(sound: dict[bool, Evidence]) -> None:
    evidence = planted(sound[False], None)
    evidence.notes = [Note(at + 1.5 * (step == "listening"), step, said) for at, step, said in evidence.notes]
    (verdict,) = judge(evidence, {"primary-rate": requirements()["primary-rate"]})
    assert verdict.state == "held"
    assert 12 <= int(verdict.seen.split()[-2]) <= 15  # the second half of 3 s


def test_dashboard_modes_ignore_states_of_later_stages(sound: dict[bool, Evidence]) -> None:
    evidence = planted(sound[False], None)
    *before, last = evidence.primary.states
    runs = SimpleNamespace(robot_mode=last.robot_mode_data.robot_mode, is_program_running=True)
    later = SimpleNamespace(robot_mode_data=runs, masterboard_data=last.masterboard_data)
    evidence.primary = replace(evidence.primary, states=[*before, later])
    modes = {"dashboard-modes": requirements()["dashboard-modes"]}
    assert [each.state for each in judge(evidence, modes)] == ["not held"]
    evidence.notes.append(Note(evidence.primary.arrivals[-1], "stage", {"number": 2}))
    assert [each.state for each in judge(evidence, modes)] == ["held"]

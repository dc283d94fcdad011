"""Defects that are drawn by a seed are found, and nothing else is."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path

import pytest

import urlink
from packages.accept.tests.acceptance.drawn import (
    FIRMWARES,
    SEED,
    Drawn,
    all_defects,
    drawn,
    is_found,
    is_named,
    sound,
    verdicts_with,
)
from tests.matrix import trials
from urlink.simulator import Controller
from urlink.simulator.interfaces.realtime import FIELDS
from urlink_accept.acceptance.causes import refuted_positions
from urlink_accept.acceptance.evidence import Evidence, Note
from urlink_accept.acceptance.person import OfTheSimulator
from urlink_accept.acceptance.report import as_html, as_text, judge
from urlink_accept.acceptance.requirements import requirements
from urlink_accept.acceptance.stages import run
from urlink_accept.identification.exercise import Guard

_FEW = trials(6, 30)


@pytest.fixture(scope="module")
def base(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Evidence]:
    """Function that returns the evidence of a sound controller with this firmware."""

    @cache
    def made(firmware: str) -> Evidence:
        evidence = sound(firmware, tmp_path_factory.mktemp("sound") / f"{firmware}.urlog")
        assert [each.seen for each in judge(evidence, requirements()) if each.state == "not held"] == []
        return evidence

    return made


def test_at_least_200_different_defects_can_be_drawn() -> None:
    assert len(set(all_defects())) == len(all_defects()) >= 200


@pytest.mark.slow
@pytest.mark.timeout(900)
@pytest.mark.parametrize(
    ("firmware", "defect"),
    [
        ("5.11", Drawn("tool_accelerometer", "frozen", "realtime and rtde")),
        ("3.15", Drawn("tcp_force", "in another order", "realtime and rtde")),
    ],
    ids=str,
)
def test_defect_on_both_interfaces_is_named(base: Callable[[str], Evidence], firmware: str, defect: Drawn) -> None:
    assert is_named(verdicts_with(base(firmware), defect), defect)


@pytest.mark.slow
@pytest.mark.matrix
@pytest.mark.timeout(900)
def test_drawn_defects_are_found_and_named(base: Callable[[str], Evidence]) -> None:
    # The evidence of each firmware takes half a minute.
    bases = {each: base(each) for each in FIRMWARES[: trials(2, 3)]}
    found, named = [], []
    for firmware, defect in drawn(SEED, _FEW, bases):
        verdicts = verdicts_with(bases[firmware], defect)
        found.append(is_found(verdicts))
        named.append(is_named(verdicts, defect))
    assert sum(found) >= 0.9 * _FEW - 1
    assert sum(named) >= 0.8 * _FEW - 1


def test_moving_stage_is_skipped_when_positions_are_refuted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "run.urlog"
    monkeypatch.setattr("urlink_accept.acceptance.stages.refuted_positions", lambda verdicts: "tracking is NOT HELD")
    monkeypatch.setattr(Guard, "__init__", lambda *args: pytest.fail("the stage began"))
    with urlink.simulated_time(seed=3):
        run("sim://?firmware=3.15", path, (0, 2), lambda number, does: "", seconds=1.0)
    (moving,) = (each for each in judge(Evidence(path), requirements()) if each.requirement.name == "move-arrives")
    expected = "stage 2 was not run: the joint positions cannot be trusted, because tracking is NOT HELD"
    assert (moving.state, moving.seen) == ("not tried", expected)


@pytest.fixture(scope="module")
def listened(tmp_path_factory: pytest.TempPathFactory) -> Evidence:
    """Two seconds of a sound CB3."""
    path: Path = tmp_path_factory.mktemp("listened") / "run.urlog"
    with urlink.simulated_time(seed=3):
        run("sim://?firmware=3.15", path, (0,), lambda number, does: "", seconds=2.0)
    return Evidence(path)


@pytest.mark.parametrize("transformation", ["negated", "frozen"])
def test_refuted_positions_names_changed_positions(listened: Evidence, transformation: str) -> None:
    (defect,) = (each for each in all_defects() if str(each) == f"q_actual {transformation} on realtime and rtde")
    assert "q_actual" in refuted_positions(verdicts_with(listened, defect))
    assert refuted_positions(judge(listened, requirements())) == ""


def test_page_begins_with_verdict_and_draws_quantities(listened: Evidence) -> None:
    (defect,) = (each for each in all_defects() if str(each) == "q_actual negated on realtime and rtde")
    verdicts = verdicts_with(listened, defect)
    text, page = as_text(listened, verdicts, {}), as_html(listened, verdicts, {}, address="10.0.0.7")
    title, _, _, mark, _, result, cause = text.splitlines()[:7]
    assert (title, mark.strip("*"), result.partition(":")[0]) == (
        "Acceptance of a controller with urlink",
        " SIMULATED ARM ",
        "NOT ACCEPTED",
    )
    assert cause.startswith("Likely cause: ")
    assert "address      sim://?firmware=3.15" in text
    assert page.index("NOT ACCEPTED") < page.index("<svg") < page.index("<th>requirement</th>")
    assert page.count("<svg") == 4
    assert "<td>10.0.0.7</td>" in page
    assert '<div class="simulated">SIMULATED</div>' in page


@pytest.mark.parametrize(("by", "state"), [(0.2, "not tried"), (0.0, "not held")])
def test_step_is_reported_as_not_tried_after_computer_delay(listened: Evidence, by: float, state: str) -> None:
    evidence = Evidence.__new__(Evidence)
    evidence.__dict__.update(listened.__dict__)
    evidence.__dict__.pop("_delays", None)
    at = listened.notes[-1].at
    evidence.notes = [*listened.notes, Note(at, "stage", {"number": 1}), Note(at + 0.1, "latency", {"event": "begin"})]
    evidence.notes += [Note(at + 0.5, "delayed", {"by": by})]
    evidence.notes += [Note(at + 1.0, "latency", {"event": "end", "error": None, "delays": [0.3] * 5, "tried": 5})]
    (verdict,) = judge(evidence, {"latency": requirements()["latency"]})
    assert verdict.state == state
    assert ("this computer was busy" in verdict.seen) == (by > 0.0)


def test_moving_stage_listens_first_if_stage_0_is_not_requested(tmp_path: Path) -> None:
    """Positions with the wrong sign are planted in the packets of the controller itself."""
    path = tmp_path / "run.urlog"
    with urlink.simulated_time(seed=3), Controller("UR5", "3.15") as controller, pytest.MonkeyPatch.context() as patch:
        patch.setitem(FIELDS, "q_actual", lambda shown: [-each for each in shown.sample.q_actual])
        run(controller.address, path, (2,), lambda number, does: "", person=OfTheSimulator(controller))
    (stage,) = Evidence(path).said("stage")
    assert "the joint positions cannot be trusted" in stage.said["refused"]

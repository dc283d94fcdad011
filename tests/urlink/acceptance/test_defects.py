"""Each planted defect is named for what it is."""

from __future__ import annotations

from pathlib import Path

import pytest

import urlink
from tests.urlink.acceptance.defects import DEFECTS, planted
from urlink.acceptance.evidence import Evidence
from urlink.acceptance.report import CHECKS, judge
from urlink.acceptance.requirements import requirements
from urlink.acceptance.stages import run


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> dict[bool, Evidence]:
    """Three seconds of a sound arm that stands, and of one that moves."""
    found = {}
    for moves in (False, True):
        path: Path = tmp_path_factory.mktemp("sound") / "run.urlog"
        address = "sim://ur5e?firmware=5.11" + "&motion=demo" * moves
        with urlink.simulated_time(seed=3):
            run(address, path, (0,), lambda number, does: "", seconds=3.0)
        found[moves] = Evidence(path)
    return found


def test_there_are_enough() -> None:
    assert len(DEFECTS) >= 60
    assert {each.named for each in DEFECTS.values()} <= CHECKS.keys()


@pytest.mark.parametrize("name", DEFECTS)
def test_a_defect_is_named_for_what_it_is(sound: dict[bool, Evidence], name: str) -> None:
    defect = DEFECTS[name]
    # The other requirements may be held or not.
    named = {defect.named: requirements()[defect.named]}
    (verdict,) = judge(planted(sound[defect.moves], defect), named)
    assert verdict.state == "not held", verdict
    assert defect.said in verdict.seen


@pytest.mark.parametrize("moves", [False, True])
def test_the_runs_themselves_are_sound(sound: dict[bool, Evidence], moves: bool) -> None:
    """Nothing is planted in what is shared."""
    assert [each.seen for each in judge(planted(sound[moves], None), requirements()) if each.state == "not held"] == []

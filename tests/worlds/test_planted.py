"""The defects of `planted`: each applies to the code of today, and shows in its world; without it nothing does."""

from __future__ import annotations

from dataclasses import replace

import pytest

from tests.worlds.planted import NAMES, ROOT, SHOWN, apply, planted, worlds
from tests.worlds.running import run

# A client that is killed closes nothing.
pytestmark = pytest.mark.filterwarnings("ignore::ResourceWarning", "ignore::pytest.PytestUnraisableExceptionWarning")


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.real_time
def test_a_defect_applies_to_the_code_of_today(name: str) -> None:
    apply(name, ROOT, "--check")


@pytest.mark.slow
@pytest.mark.parametrize("name", SHOWN)
@pytest.mark.real_time
def test_a_defect_shows_in_its_world(name: str) -> None:
    with planted(name) as root:
        found = worlds(root, ["--shown", name])
    assert found.returncode == 1
    assert "FAULT:" in found.stdout


@pytest.mark.slow
@pytest.mark.parametrize("name", SHOWN)
def test_without_the_defect_nothing_is_wrong_in_that_world(name: str) -> None:
    world, _ = SHOWN[name]
    outcome = run(replace(world, seed=1))
    assert outcome.faults == [], "\n".join(outcome.log)

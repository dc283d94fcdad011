"""All states of the model, the defects that it finds, and a comparison with the handles of simulated worlds."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import cache
from typing import Any

import pytest

from linkcore.handle import Event, Lifecycle, Phase
from tests.worlds.drawn import draw
from tests.worlds.model import DEFECTS, ENDS, Explored, begin, explore
from tests.worlds.running import run

# A killed client does not close its sockets, so ignore the warnings.
pytestmark = [
    pytest.mark.slow,
    pytest.mark.filterwarnings("ignore::ResourceWarning", "ignore::pytest.PytestUnraisableExceptionWarning"),
]


@cache
def whole(*owners: int) -> Explored:
    return explore(begin(*owners))


@pytest.mark.parametrize("owners", [(0, 1), (0, 0)], ids=["two clients", "one client asks twice"])
def test_invariants_hold_in_every_state(
    owners: tuple[int, ...], record_property: Callable[[str, object], None]
) -> None:
    begun = time.perf_counter()
    found = whole(*owners)
    record_property("states", found.states)
    record_property("steps", found.steps)
    record_property("seconds", round(time.perf_counter() - begun, 1))
    print(f"{found.states} states, {found.steps} steps, {time.perf_counter() - begun:.1f} s")
    assert not found.violated, "\n".join(f"{name}:\n  " + "\n  ".join(way) for name, way in found.violated.items())
    assert found.states > 5000


@pytest.mark.parametrize("defect", DEFECTS)
def test_model_finds_each_defect(defect: str) -> None:
    owners, invariant = DEFECTS[defect]
    found = explore(begin(*owners), defect, until=() if invariant == ENDS else (invariant,))
    way = found.violated[invariant]
    print(f"{defect}: violated: {invariant}\n  " + "\n  ".join(way))
    assert len(way) <= 10  # short enough for a person to read


def test_handles_in_random_worlds_behave_like_the_model(monkeypatch: pytest.MonkeyPatch) -> None:
    seen: set[tuple[str, str]] = set()
    fire = Lifecycle.fire

    def recorded(life: Lifecycle, event: Event, *rest: Any, **named: Any) -> bool:
        before: Phase = life.phase
        has_happened = fire(life, event, *rest, **named)
        if life.phase is not before:
            seen.add((before.value, life.phase.value))
        return has_happened

    monkeypatch.setattr(Lifecycle, "fire", recorded)
    places: set[tuple[tuple[str, str], tuple[str, str]]] = set()
    for seed in range(10):
        outcome = run(draw(seed))
        assert outcome.faults == []
        places |= outcome.places
    # A program moves the arm only after its client has read its request and has permitted it.
    assert places <= whole(0, 1).places | whole(0, 0).places
    assert any(after == ("running", "moves") for _, after in places)
    modelled = whole(0, 1).transitions | whole(0, 0).transitions
    assert seen <= modelled
    assert {after for _, after in seen} == {
        Phase.RUNNING.value,
        Phase.DONE.value,
        Phase.CANCELLED.value,
        Phase.FAILED.value,
    }

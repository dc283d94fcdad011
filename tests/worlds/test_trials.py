"""Each trial passes with the unchanged library, and the additional checks detect violations."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping

import pytest

from linkcore import clock
from linkcore.simulated import simulated_time
from linkcore.streaming.packet_queue import PacketQueue, latest
from tests.worlds import learned, waits
from tests.worlds.running import run
from tests.worlds.trials import AWAITED, MOBILE, TRIALS
from tests.worlds.world import Ask, Client, World

pytestmark = pytest.mark.filterwarnings("ignore::ResourceWarning", "ignore::pytest.PytestUnraisableExceptionWarning")

KINDS: dict[str, Mapping[str, Callable[..., object]]]
KINDS = {"trials": TRIALS, "trials in tasks": AWAITED, "mobile trials": MOBILE}
EVERY = [(kind, name) for kind, trials in KINDS.items() for name in trials]


@pytest.mark.parametrize(("kind", "name"), EVERY)
def test_each_trial_passes_on_the_simulator(kind: str, name: str) -> None:
    for number, firmware in enumerate(("3.15", "5.11")):
        ask = Ask(name, "wait", 0.0, 0.3 * number + 0.05, 0.0)
        outcome = run(World(number, firmware, 1e-4, 0.0, (Client((ask,), 0.0, kind),), ()))
        assert outcome.faults == [], "\n".join(outcome.log)


@pytest.mark.parametrize(("kind", "name"), EVERY)
def test_every_trial_has_a_docstring_with_its_promise(kind: str, name: str) -> None:
    assert KINDS[kind][name].__doc__


def test_wait_with_a_lost_timeout_is_a_fault() -> None:
    faults: list[str] = []
    with waits.watching(faults.append):
        clock.wait(lambda seconds: True, 60.0)
        assert faults == []
        clock.wait(lambda seconds: True, 1e6)
    assert len(faults) > 0


@pytest.mark.real_time  # on Windows, an event loop connects two sockets
def test_timer_with_a_lost_timeout_is_a_fault() -> None:
    faults: list[str] = []

    async def begin() -> None:
        asyncio.get_running_loop().call_later(1e6, print).cancel()

    with waits.watching(faults.append):
        asyncio.run(begin())
    assert len(faults) == 1


def test_assignment_without_its_lock_is_a_fault() -> None:
    faults: list[str] = []
    row = learned.Row("PacketQueue", "_discarded", "assigned", "_discarding")
    assert row in learned.KNOWN
    with simulated_time(1), learned.watching(faults.append, (row,)):
        queue = PacketQueue(latest)
        with queue._discarding:
            queue._discarded = 1
        assert faults == []
        queue._discarded = 2
    assert faults == ["PacketQueue._discarded changes without _discarding"]


@pytest.mark.parametrize(("kind", "is_held"), [("with", False), ("without", True)])
def test_call_with_an_unexpected_lock_state_is_a_fault(kind: str, is_held: bool) -> None:
    faults: list[str] = []
    row = learned.Row("BoundedQueue", "end", kind, "_discarding")
    with simulated_time(1), learned.watching(faults.append, (row,)):
        queue = PacketQueue(latest)
        with queue._discarding:
            if is_held:
                queue.close if kind == "with" else queue.end()
        if not is_held:
            queue.end()
    assert len(faults) == (kind == "with")  # a plain lock does not know its owner


def test_methods_in_the_lock_table_still_exist() -> None:
    named = [(each.__name__, each) for each in learned.every_class()]
    lost = [
        row
        for row in learned.KNOWN
        if row.kind != "assigned" and not any(name == row.owner and hasattr(each, row.name) for name, each in named)
    ]
    assert lost == [], "these methods no longer exist; learn again: python -m tests.worlds.learned"

"""Threads of a simulation wake up on one processor, and may use all processors while they run."""

from __future__ import annotations

import os
import queue
import sys
import threading
from collections.abc import Iterator

import pytest

import urlink
from linkcore.simulated import processor
from linkcore.simulated.processor import Processor

if sys.platform != "linux":
    pytest.skip("only Linux can restrict a thread to processors", allow_module_level=True)

ALLOWED = os.sched_getaffinity(0)
needs_two = pytest.mark.skipif(len(ALLOWED) < 2, reason="needs two processors")


@pytest.fixture(autouse=True)
def _all_processors_afterwards() -> Iterator[None]:
    yield
    os.sched_setaffinity(0, ALLOWED)


@needs_two
def test_thread_is_restricted_only_while_it_waits() -> None:
    one = Processor()
    narrowed = one.narrow()
    waiting = os.sched_getaffinity(0)
    one.widen(narrowed)
    assert len(waiting) == 1
    assert waiting < ALLOWED
    assert os.sched_getaffinity(0) == ALLOWED


@needs_two
def test_processors_that_were_set_during_a_wait_are_kept() -> None:
    one = Processor()
    narrowed = one.narrow()
    assert narrowed is not None
    others = ALLOWED - narrowed[0]
    os.sched_setaffinity(0, others)
    one.widen(narrowed)
    assert os.sched_getaffinity(0) == others


def test_thread_with_a_single_processor_is_not_restricted() -> None:
    os.sched_setaffinity(0, {min(ALLOWED)})
    assert Processor().narrow() is None


@pytest.mark.parametrize("found", [set(), {max(ALLOWED) + 1}])
def test_unknown_processor_is_not_used(found: set[int], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(processor, "_current", lambda: found)
    assert Processor().narrow() is None
    assert os.sched_getaffinity(0) == ALLOWED


@needs_two
def test_refused_restriction_is_ignored(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(number: int, cpus: set[int]) -> None:
        raise PermissionError("not in this container")

    monkeypatch.setattr(os, "sched_setaffinity", refuse)
    assert Processor().narrow() is None
    monkeypatch.undo()


@needs_two
def test_processor_follows_the_running_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    one, last = Processor(), max(ALLOWED)
    monkeypatch.setattr(processor, "_current", lambda: {min(ALLOWED)})
    one.widen(one.narrow())
    monkeypatch.setattr(processor, "_current", lambda: {last})
    found = []
    for _ in range(processor._RENEWAL):
        narrowed = one.narrow()
        assert narrowed is not None
        found.append(narrowed[0])
        one.widen(narrowed)
    assert [found[0], found[-1]] == [{min(ALLOWED)}, {last}]


def test_threads_of_a_simulation_may_use_all_processors_while_they_run() -> None:
    seen: list[set[int]] = []
    with urlink.simulated_time(0):
        there: queue.Queue[int] = queue.Queue()
        back: queue.Queue[int] = queue.Queue()

        def answer() -> None:
            for _ in range(100):
                seen.append(os.sched_getaffinity(0))
                back.put(there.get())

        thread = threading.Thread(target=answer)
        thread.start()
        for number in range(100):
            there.put(number)
            assert back.get() == number
            seen.append(os.sched_getaffinity(0))
        thread.join()
    seen.append(os.sched_getaffinity(0))
    assert len(seen) == 201
    assert all(each == ALLOWED for each in seen)

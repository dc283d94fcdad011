"""Marks that decide whether a test and its fixtures run in simulated time."""

from __future__ import annotations

import threading
import time

import pytest

pytestmark = pytest.mark.simulated_time


@pytest.fixture
def begun() -> float:
    return time.monotonic()


def test_fixtures_and_test_use_the_same_simulated_clock(begun: float) -> None:
    waited = threading.Event()
    timer = threading.Timer(7200.0, waited.set)
    timer.start()
    assert waited.wait(7300.0)
    timer.join()
    assert 7200.0 <= time.monotonic() - begun < 7201.0


@pytest.mark.real_time
def test_real_time_test_has_the_locks_and_clock_of_the_system(begun: float) -> None:
    assert type(threading.Lock()).__module__ == "_thread"
    assert begun <= time.monotonic() < begun + 600.0

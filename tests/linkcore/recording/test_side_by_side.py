"""Parallel computation in shares: every share runs once, in order, with any number of processors."""

from __future__ import annotations

import threading

import pytest

from linkcore.recording.index import side_by_side
from tests.waiting import threads_named


@pytest.mark.parametrize("processors", [1, 3])
@pytest.mark.parametrize("size", [0, 1, 10, 11, 95])
@pytest.mark.simulated_time
def test_side_by_side_returns_results_in_order_of_the_input(
    processors: int, size: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("os.cpu_count", lambda: processors)
    shares = side_by_side(lambda begin, end: list(range(begin, end)), 5, 5 + size, 10)
    assert [each for share in shares for each in share] == list(range(5, 5 + size))
    assert all(len(share) == 10 for share in shares[:-1])


@pytest.mark.simulated_time
def test_side_by_side_runs_in_parallel_and_raises_errors(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("os.cpu_count", lambda: 2)
    both = threading.Barrier(2, timeout=20.0)
    assert side_by_side(lambda begin, _: both.wait() >= 0 and begin, 0, 2, 1) == [0, 1]
    with pytest.raises(ZeroDivisionError):
        side_by_side(lambda begin, _: 1 // (3 - begin), 0, 8, 1)
    assert not threads_named("recording")

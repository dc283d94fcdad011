"""Waits between connection attempts: they grow up to a maximum, and differ between clients."""

from __future__ import annotations

import itertools
import math
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from linkcore.errors import BadValue
from linkcore.streaming.connection_life import Backoff

pytestmark = pytest.mark.simulated_time

seconds = st.floats(0, 100)
factors = st.floats(1, 10)
shares = st.floats(0, 1)


def first_waits(backoff: Backoff, count: int = 50) -> list[float]:
    return list(itertools.islice(backoff.waits(), count))


def test_backoff_waits_grow_up_to_a_maximum() -> None:
    assert first_waits(Backoff(first=1, factor=2, most=10, jitter=0), 6) == [1, 2, 4, 8, 10, 10]


@pytest.mark.property
@given(seconds, factors, seconds)
def test_backoff_waits_without_jitter_grow_up_to_a_maximum(first: float, factor: float, most: float) -> None:
    waits = first_waits(Backoff(first, factor, most, jitter=0))
    assert len(waits) == 50, "the waits must not end"
    assert waits == sorted(waits)
    assert waits[0] == min(first, most)
    assert all(0 <= wait <= most for wait in waits)


@pytest.mark.property
@given(seconds, factors, seconds, shares)
def test_jitter_varies_each_backoff_wait_by_its_share(first: float, factor: float, most: float, jitter: float) -> None:
    steady = first_waits(Backoff(first, factor, most, jitter=0))
    varied = first_waits(Backoff(first, factor, most, jitter=jitter))
    for wait, exact in zip(varied, steady, strict=True):
        assert exact * (1 - jitter) - 1e-9 <= wait <= exact * (1 + jitter) + 1e-9


def test_wait_with_jitter_does_not_exceed_the_maximum() -> None:
    assert max(first_waits(Backoff(first=1, factor=2, most=4, jitter=0.5), 200)) <= 4


def test_two_clients_get_different_backoff_waits() -> None:
    assert first_waits(Backoff(jitter=0.2)) != first_waits(Backoff(jitter=0.2))


@pytest.mark.parametrize("tries", [0, 1, 7])
def test_backoff_ends_after_the_given_number_of_tries(tries: int) -> None:
    assert len(first_waits(Backoff(tries=tries))) == tries


def test_each_use_of_a_backoff_starts_with_the_first_wait() -> None:
    backoff = Backoff(first=1, factor=10, most=1000, jitter=0)
    assert first_waits(backoff, 3) == first_waits(backoff, 3) == [1, 10, 100]


@pytest.mark.parametrize(
    "wrong",
    [
        *({"first": value} for value in (-1, math.nan, "soon", None)),
        *({"most": -0.1}, {"factor": 0.5}, {"factor": math.nan}, {"jitter": -0.1}, {"jitter": 1.1}, {"tries": -1}),
    ],
    ids=str,
)
def test_backoff_rejects_invalid_values(wrong: dict[str, Any]) -> None:
    with pytest.raises(BadValue, match=f"{next(iter(wrong))}="):
        Backoff(**wrong)

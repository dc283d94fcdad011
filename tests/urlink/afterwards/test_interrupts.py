"""Ctrl-C at a random moment after the start of a motion stops the arm; `interrupts.py` tries more moments."""

from __future__ import annotations

import random
from collections.abc import Iterator

import pytest

from tests.urlink.afterwards.interrupts import KINDS, WITHIN, arms, interrupted
from urlink.robot import Robot

pytestmark = [
    pytest.mark.real_time,
    pytest.mark.slow,
]


@pytest.fixture(scope="module")
def robots() -> Iterator[list[Robot]]:
    with arms() as robots:
        yield robots


@pytest.mark.parametrize("kind", KINDS)
def test_interrupt_stops_the_arm(robots: list[Robot], kind: str) -> None:
    after = random.Random(kind).uniform(0.0, WITHIN)
    assert interrupted(robots, kind, after) == ""

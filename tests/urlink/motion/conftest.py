"""Robots for the tests of motions; nothing of them is left behind."""

from __future__ import annotations

import gc
import threading
from collections.abc import Callable, Iterator

import pytest

from tests.fakes.rehearsal import Rehearsal
from tests.waiting import until
from tests.worlds.guarded import guards

__all__ = ["guards"]


@pytest.fixture(autouse=True)
def leaves_nothing() -> Iterator[None]:
    """No thread, and no socket: one that nobody closed warns when it is collected."""
    before = set(threading.enumerate())
    yield
    until(lambda: set(threading.enumerate()) <= before)
    # What was made lately: all there is, 6 ms for each of a thousand tests, is looked through after the module.
    gc.collect(1)


@pytest.fixture
def rehearsal() -> Iterator[Callable[..., Rehearsal]]:
    """Makes a robot that does what the test says."""
    made: list[Rehearsal] = []

    def make(*arguments: object, **options: object) -> Rehearsal:
        made.append(Rehearsal(*arguments, **options))  # type: ignore[arg-type]
        return made[-1]

    yield make
    for each in made:
        each.close()


@pytest.fixture
def robot(rehearsal: Callable[..., Rehearsal]) -> Rehearsal:
    """An e-Series robot that does what the test says."""
    return rehearsal()


@pytest.fixture(params=["reverse", "rtde"])
def led(request: pytest.FixtureRequest, rehearsal: Callable[..., Rehearsal]) -> Rehearsal:
    """The same, led over either link."""
    return rehearsal(link=request.param)

"""Robots for the tests of motions, and a check that the tests leave no thread or socket behind."""

from __future__ import annotations

import gc
import threading
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from linkcore.handle import Lifecycle
from tests.fakes.rehearsal import Rehearsal
from tests.waiting import until
from tests.worlds.guarded import guards
from urlink.motion.context import MotionContext
from urlink.motion.servo import block_motion
from urlink.motion.servo.linked_program import LinkedProgram
from urlink.motion.servo.setpoints import LinkDialogue

__all__ = ["guards"]


@pytest.fixture(autouse=True)
def leaves_nothing() -> Iterator[None]:
    """Check that no thread remains; an open socket causes a warning when it is collected."""
    before = set(threading.enumerate())
    yield
    until(lambda: set(threading.enumerate()) <= before)
    # Collect young objects only: a full collection takes 6 ms, for each of a thousand tests. It runs after the module.
    gc.collect(1)


@pytest.fixture
def dialogues(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """Dialogues with the programs of the blocks that the test makes, in order."""
    made: list[Any] = []

    def make(
        life: Lifecycle, context: MotionContext, dialogue: LinkDialogue, *more: Any, **options: Any
    ) -> LinkedProgram:
        made.append(dialogue)
        return LinkedProgram(life, context, dialogue, *more, **options)

    monkeypatch.setattr(block_motion, "LinkedProgram", make)
    return made


@pytest.fixture
def rehearsal() -> Iterator[Callable[..., Rehearsal]]:
    """Return a function that makes scripted robots."""
    made: list[Rehearsal] = []

    def make(*arguments: object, **options: object) -> Rehearsal:
        made.append(Rehearsal(*arguments, **options))  # type: ignore[arg-type]
        return made[-1]

    yield make
    for each in made:
        each.close()


@pytest.fixture
def robot(rehearsal: Callable[..., Rehearsal]) -> Rehearsal:
    """Scripted e-Series robot."""
    return rehearsal()


@pytest.fixture(params=["reverse", "rtde"])
def led(request: pytest.FixtureRequest, rehearsal: Callable[..., Rehearsal]) -> Rehearsal:
    """Scripted e-Series robot, driven over each of the two links."""
    return rehearsal(link=request.param)

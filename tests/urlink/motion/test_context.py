"""Which state of the robot a motion begins from."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any, cast

import pytest

from urlink.motion.context import MotionContext


def state(received: float | None) -> Any:
    return SimpleNamespace(received=None if received is None else SimpleNamespace(monotonic=received))


class Waiting:
    """A robot whose last program ended at 10 s; `coming` are its next states, the last of which is its newest then."""

    def __init__(self, newest: Any, *coming: Any, newest_then: Any = None) -> None:
        self.latest = newest
        self._coming = coming
        self._newest_then = newest_then
        self.has_waited = False

    def waiting(self) -> contextlib.AbstractContextManager[None]:
        self.has_waited = True
        return contextlib.nullcontext()

    def wait_until(self, condition: Callable[[Any], bool]) -> Any:
        assert self.has_waited
        self.latest = self._newest_then
        return next(state for state in self._coming if condition(state))

    def state(self) -> Any:
        context = SimpleNamespace(realtime=self, programs=SimpleNamespace(ended=10.0), section=self)
        return MotionContext.state(cast(MotionContext, context))


def test_a_state_since_the_end_of_the_last_program_will_do() -> None:
    newest = state(10.001)
    robot = Waiting(newest)
    assert robot.state() is newest
    assert not robot.has_waited


@pytest.mark.parametrize("newest", [None, state(9.0), state(10.0), state(None)])
def test_else_the_next_one_is_waited_for(newest: Any) -> None:
    """Where states were held up, the first one may be from before that end, and the newest counts."""
    first, last = state(10.1), state(10.2)
    robot = Waiting(newest, state(9.5), state(10.0), state(None), first, newest_then=last)
    assert robot.state() is last
    assert robot.has_waited
    assert Waiting(newest, first).state() is first  # the connection is lost meanwhile

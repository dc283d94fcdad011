"""The state of the robot that a motion starts from."""

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
    """Robot whose last program ended at 10 s.

    `coming` are its next states, and `newest_then` is its newest state after the wait.
    """

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


def test_state_after_end_of_last_program_is_used() -> None:
    newest = state(10.001)
    robot = Waiting(newest)
    assert robot.state() is newest
    assert not robot.has_waited


@pytest.mark.parametrize("newest", [None, state(9.0), state(10.0), state(None)])
def test_motion_waits_for_state_after_end_of_last_program(newest: Any) -> None:
    """If states were delayed, the first one might be older than that end, so the newest one is used."""
    first, last = state(10.1), state(10.2)
    robot = Waiting(newest, state(9.5), state(10.0), state(None), first, newest_then=last)
    assert robot.state() is last
    assert robot.has_waited
    assert Waiting(newest, first).state() is first  # the connection is lost meanwhile

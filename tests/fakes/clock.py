"""A clock that the test sets, for what takes its time from one clock and has no threads; else time is simulated."""

from __future__ import annotations

from collections.abc import Callable
from types import ModuleType, SimpleNamespace

import pytest

import linkcore.clock

__all__ = ["Clock", "Suspend"]


class Clock:
    """Stands still until the test sets `now`, or something sleeps by it.

    Attributes:
        now: s.
        sleeps: seconds of each sleep.
        meanwhile: called in each sleep, when the time has come.
    """

    def __init__(self, now: float = 100.0) -> None:
        self.now = now
        self.sleeps: list[float] = []
        self.meanwhile: Callable[[], object] = lambda: None

    def __call__(self) -> float:
        return self.now

    def sleep(self, seconds: float) -> None:
        self.sleeps.append(seconds)
        self.now += seconds
        self.meanwhile()

    def replace(self, module: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
        """Have a module take its time from here."""
        fake = SimpleNamespace(now=self, sleep=self.sleep, left=lambda until: max(until - self.now, 0.0))
        monkeypatch.setattr(module, "clock", fake)


class Suspend:
    """Advances `linkcore.clock` when it is called, and nothing else, as a suspend of this computer does."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self._seconds = 0.0
        self._read: Callable[..., float] = linkcore.clock.read
        monkeypatch.setattr(linkcore.clock, "read", self._late)

    def _late(self, *which: int) -> float:
        return self._read(*which) + self._seconds

    def __call__(self, seconds: float) -> None:
        self._seconds += seconds

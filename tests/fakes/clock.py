"""Clock that the test sets, for objects that use one clock and no threads. Other tests use simulated time."""

from __future__ import annotations

from collections.abc import Callable
from types import ModuleType, SimpleNamespace

import pytest

import linkcore.clock

__all__ = ["Clock", "Suspend"]


class Clock:
    """Clock that advances only if the test sets `now`, or if a caller sleeps with it.

    Attributes:
        now: Time of the clock, in s.
        sleeps: Duration of each sleep, in s.
        meanwhile: Function that is called at the end of each sleep.
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
        """Make a module use this clock."""
        fake = SimpleNamespace(now=self, sleep=self.sleep, left=lambda until: max(until - self.now, 0.0))
        monkeypatch.setattr(module, "clock", fake)


class Suspend:
    """Function that advances only `linkcore.clock`, as a suspend of this computer does."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self._seconds = 0.0
        self._read: Callable[..., float] = linkcore.clock.read
        monkeypatch.setattr(linkcore.clock, "read", self._late)

    def _late(self, *which: int) -> float:
        return self._read(*which) + self._seconds

    def __call__(self, seconds: float) -> None:
        self._seconds += seconds

"""Motions that are one short program: sent, and then the controller's affair."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

import numpy as np

from ..commanding.handle import Program, ProgramPhase
from ..errors import ProgramStopped
from ..interfaces.realtime.packets import RealtimeState
from ..vectors import FloatArray
from .equipment import Equipment
from .handle import Motion

__all__ = ["UploadedMotion", "arriving", "lasting"]

#: Tells how much of a motion is behind the arm, from the newest state.
Gauge = Callable[[RealtimeState], float]


class UploadedMotion(Motion):
    """A program that moves the arm and ends.

    Args:
        body: its lines.
        gauge: measures its progress; None for one that cannot be measured.
        brakes: it can only bring the arm to rest.
    """

    def __init__(
        self,
        name: str,
        equipment: Equipment,
        body: Sequence[str],
        gauge: Gauge | None = None,
        *,
        brakes: bool = False,
    ) -> None:
        super().__init__(name, equipment)
        self._body = body
        self._gauge = gauge
        self._brakes = brakes
        self._program: Program | None = None

    def _begin(self) -> None:
        self._program = self._equipment.scripts.start(self._body, brakes=self._brakes)
        self._program.add_done_callback(self._ended)

    def _ended(self, program: Program) -> None:
        if program.phase is ProgramPhase.FINISHED:
            self._complete()
        else:
            self._fail(program.error or ProgramStopped(f"{self.name} was stopped"))

    def _brake(self) -> None:
        if self._program is not None:
            self._program.stop()

    def _measure(self) -> float:
        state = None if self._gauge is None or self._program is None else self._equipment.realtime.latest
        return 0.0 if state is None or self._gauge is None else self._gauge(state)


def arriving(goal: FloatArray, where: Callable[[RealtimeState], FloatArray]) -> Gauge:
    """By the way left to a goal: of all coordinates, the one that is furthest; from the first state that is seen."""
    whole: list[float] = []

    def gauge(state: RealtimeState) -> float:
        left = float(np.abs(goal - where(state)).max())
        if not whole:
            whole.append(left)
        return 1.0 - left / whole[0] if whole[0] > 0.0 else 1.0

    return gauge


def lasting(seconds: float) -> Gauge:
    """By the time since now."""
    began = time.monotonic()
    return lambda state: (time.monotonic() - began) / seconds

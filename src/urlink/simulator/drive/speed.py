"""Constant speeds of the joints: speedj, and stopj, which is a speed of zero."""

from __future__ import annotations

from collections.abc import Sequence

from ..motion import Setpoint
from .move import Move

__all__ = ["JointSpeed"]

_REST = [0.0] * 6


class JointSpeed:
    """All joints change their speeds in proportion until each has its own, and keep it.

    Attributes:
        move: over after `t` s, or when the speed is reached where that is None.
    """

    def __init__(self, qd: Sequence[float], acceleration: Sequence[float], t: float | None) -> None:
        """Six speeds in rad/s, and six accelerations in rad/s² that the joints are not to exceed."""
        self.move = Move()
        self._target, self._acceleration = list(qd), acceleration
        self._left = t
        self._stops = not any(qd)
        self.is_at_rest = False

    def advance(self, last: Setpoint, seconds: float, pace: float, change: float) -> Setpoint:
        """The set-point one cycle later."""
        wanted = [pace * v - old for v, old in zip(self._target, last.qd, strict=True)]
        part = 1.0
        for way, most in zip(wanted, self._acceleration, strict=True):
            if abs(way) > most * seconds * (1.0 + 1e-9):
                part = min(part, most * seconds / abs(way))
        is_reached = part == 1.0
        if is_reached:
            qd = [pace * v for v in self._target] if not self._stops else _REST
        else:
            qd = [old + part * way for old, way in zip(last.qd, wanted, strict=True)]
        q = [a + 0.5 * seconds * (old + new) for a, old, new in zip(last.q, last.qd, qd, strict=True)]
        setpoint = Setpoint(q, qd, [(new - old) / seconds for new, old in zip(qd, last.qd, strict=True)])
        self.is_at_rest = self._stops and is_reached
        if self._left is None:
            self.move.is_over = is_reached
        else:
            self._left -= seconds
            self.move.is_over = self._left < 0.5 * seconds
        return setpoint

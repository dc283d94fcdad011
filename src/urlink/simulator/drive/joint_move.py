"""A straight line in joint space: movej."""

from __future__ import annotations

import math
from collections.abc import Sequence

from urlink.models import Model

from .. import kinematics
from ..motion import Setpoint
from .limits import Limits

__all__ = ["JointPath"]

_REST = [0.0] * 6


class JointPath:
    """Six joints that start and arrive together. Its length is the way of the joint that goes furthest, in rad.

    Attributes:
        length: rad.
        speed, acceleration: of the furthest joint at which none is above its limits, rad/s and rad/s².
    """

    def __init__(self, model: Model, limits: Limits, tcp: Sequence[float], start: list[float], end: list[float]):
        self._model, self._tcp = model, tcp
        self._start, self._end = start, end
        way = [b - a for a, b in zip(start, end, strict=True)]
        self.length = max(map(abs, way))
        self._shares = [part / self.length for part in way] if self.length > 0.0 else list(_REST)
        self.speed = _within(limits.speed, self._shares)
        self.acceleration = _within(limits.acceleration, self._shares)
        self._corner: list[float] | None = None

    def setpoint(self, way: float, speed: float, acceleration: float, last: Setpoint, seconds: float) -> Setpoint:
        """The joints where so much of the way is behind them."""
        return Setpoint(
            [a + way * share for a, share in zip(self._start, self._shares, strict=True)],
            [speed * share for share in self._shares],
            [acceleration * share for share in self._shares],
        )

    def end(self, near: Sequence[float]) -> list[float]:
        """The joints at the end."""
        return self._end

    def left(self, q: Sequence[float]) -> float:
        """How far the TCP is from its place at the end when the joints are at `q`, m."""
        if self._corner is None:
            self._corner = kinematics.pose(self._model, self._end, self._tcp).tolist()
        return math.dist(kinematics.pose(self._model, q, self._tcp)[:3].tolist(), self._corner[:3])


def _within(limits: Sequence[float], shares: Sequence[float]) -> float:
    return min((limit / abs(share) for limit, share in zip(limits, shares, strict=True) if share), default=1.0)

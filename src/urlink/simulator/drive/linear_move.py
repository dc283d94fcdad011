"""A straight line of the tool: movel, movep and servoc."""

from __future__ import annotations

import math
from collections.abc import Sequence

from urlink.models import Model

from .. import kinematics
from .tool_path import RADIAN, ToolPath, rotated, turn_between

__all__ = ["LinearPath"]


class LinearPath(ToolPath):
    """The TCP goes straight to a pose while the tool turns about one axis, both at the same pace."""

    def __init__(self, model: Model, tcp: Sequence[float], start: list[float], end: list[float]) -> None:
        """From joint positions to a pose.

        Raises:
            Unreachable: the arm does not reach the pose.
        """
        self._start: list[float] = kinematics.pose(model, start, tcp).tolist()
        self._way = [b - a for a, b in zip(self._start[:3], end[:3], strict=True)]
        self._turn = turn_between(self._start, end)
        length = max(math.hypot(*self._way), RADIAN * math.hypot(*self._turn))
        super().__init__(model, tcp, length, end, start)

    def pose(self, part: float) -> list[float]:
        """Where the TCP is, after a part in [0, 1] of the way."""
        position = [a + part * way for a, way in zip(self._start[:3], self._way, strict=True)]
        return position + rotated(self._start, self._turn, part)

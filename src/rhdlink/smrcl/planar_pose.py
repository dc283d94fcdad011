"""Class `PlanarPose`: a position and a heading in the plane."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass
class PlanarPose:
    """Position and heading: x in m, y in m, th in rad."""

    x: float = 0.0
    y: float = 0.0
    th: float = 0.0

    def set(self, x: float, y: float, th: float) -> None:
        """Set all three values."""
        self.x, self.y, self.th = x, y, th

    def copy(self) -> PlanarPose:
        """Return a copy of the pose."""
        return PlanarPose(self.x, self.y, self.th)

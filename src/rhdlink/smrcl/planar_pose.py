"""`PlanarPose`: a position and a heading in the plane."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass
class PlanarPose:
    """A place and a heading: m, m, rad."""

    x: float = 0.0
    y: float = 0.0
    th: float = 0.0

    def set(self, x: float, y: float, th: float) -> None:
        """Go there."""
        self.x, self.y, self.th = x, y, th

    def copy(self) -> PlanarPose:
        """Another one at the same place."""
        return PlanarPose(self.x, self.y, self.th)

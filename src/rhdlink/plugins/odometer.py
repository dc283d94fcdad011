"""A stream of poses as the two counters of a velocity-omega robot."""

from __future__ import annotations

import math

from linkcore.errors import BadValue

__all__ = ["Odometer", "wrapped"]


def wrapped(count: float) -> int:
    """The nearest 32-bit counter value: after 2147483647 comes -2147483648, as in the robots' counters."""
    return (round(count) + (1 << 31)) % (1 << 32) - (1 << 31)


class Odometer:
    """Turns poses into `transpos` and `rotpos`.

    The travelled distance is the displacement since the last pose projected on the heading,
    ``dx cos(theta) + dy sin(theta)``, times the linear scale, accumulated; the heading is taken times the angular
    scale. Fractions of a count are kept, so that slow motion is not lost in them. The first pose is where the counting
    begins. A heading that jumps by a turn, as one does that is kept within +-pi, is continued.

    Args:
        linear_scale: counts per m; the known robots and MRC use 100000, or what their wheels give.
        angular_scale: counts per rad; MRC's 40000 cannot be changed there.

    Attributes:
        transpos: travelled distance, counts.
        rotpos: heading, counts.

    Raises:
        BadValue: a scale that is zero or no number.
    """

    def __init__(self, linear_scale: float = 1e5, angular_scale: float = 4e4) -> None:
        for name, scale in (("linear_scale", linear_scale), ("angular_scale", angular_scale)):
            if not math.isfinite(scale) or scale == 0.0:
                raise BadValue(f"{name}={scale} is no scale")
        self._linear, self._angular = linear_scale, angular_scale
        self._last: tuple[float, float, float] | None = None
        self._travelled = 0.0
        self.transpos = 0
        self.rotpos = 0

    def update(self, x: float, y: float, theta: float) -> None:
        """Take the next pose: m, m, rad.

        Raises:
            BadValue: something that is not a finite number; nothing is changed.
        """
        travelled, heading = self._travelled, theta
        if math.isfinite(x) and math.isfinite(y) and math.isfinite(theta) and self._last is not None:
            last_x, last_y, last_theta = self._last
            travelled += ((x - last_x) * math.cos(theta) + (y - last_y) * math.sin(theta)) * self._linear
            # The shorter way round, so that a heading which is kept within +-pi does not count a turn at each wrap.
            heading = last_theta + math.remainder(theta - last_theta, 2 * math.pi)
        if not (math.isfinite(x + y + travelled) and math.isfinite(heading * self._angular)):
            raise BadValue(f"{x}, {y}, {theta} is no pose that could be counted")
        self._last = (x, y, heading)
        self._travelled = travelled
        self.transpos = wrapped(travelled)
        self.rotpos = wrapped(heading * self._angular)

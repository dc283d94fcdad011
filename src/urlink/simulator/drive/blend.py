"""What is left of the old movement while a new one begins.

A new path always begins from rest, at a place where the arm could come to rest. Beside it the old speed dies away and
takes the arm there; the sum of the two goes from the old path to the new one with a continuous speed. Joint by joint,
and for two movements with constant accelerations, the sum is a parabola.
"""

from __future__ import annotations

from collections.abc import Sequence

__all__ = ["Remainder"]

_NONE = [0.0] * 6


class Remainder:
    """The way that is still to go, as it dies away: six cubics of the time from where the arm is to nothing.

    A way of half the speed times the duration makes them parabolas: constant decelerations.

    Attributes:
        duration: s.
    """

    def __init__(
        self, way: Sequence[float], qd: Sequence[float], duration: float, acceleration: Sequence[float]
    ) -> None:
        """Six joints that have a way in rad to go and a speed in rad/s now, in at least `duration` s.

        It takes longer if one of six accelerations, rad/s², were exceeded otherwise.
        """
        worst = max(
            max(abs(6.0 * d / duration - 4.0 * v), abs(2.0 * v - 6.0 * d / duration)) / (duration * limit)
            for d, v, limit in zip(way, qd, acceleration, strict=True)
        )
        while worst > 1.0 + 1e-9:
            duration *= 1.25
            worst = max(
                max(abs(6.0 * d / duration - 4.0 * v), abs(2.0 * v - 6.0 * d / duration)) / (duration * limit)
                for d, v, limit in zip(way, qd, acceleration, strict=True)
            )
        self.duration = duration
        self._time = 0.0
        # In u = time / duration: q = -way + speed u + c u² + e u³, which is at rest at nothing where u is 1.
        self._cubics = [
            (-d, v * duration, 3.0 * d - 2.0 * v * duration, v * duration - 2.0 * d)
            for d, v in zip(way, qd, strict=True)
        ]

    @property
    def is_over(self) -> bool:
        """Nothing is left."""
        return self._time >= self.duration

    def advance(self, seconds: float) -> tuple[list[float], list[float], list[float]]:
        """What is to be added to positions, speeds and accelerations that many seconds later."""
        self._time += seconds
        if self.is_over:
            return _NONE, _NONE, _NONE
        t = self.duration
        u = self._time / t
        return (
            [a + u * (b + u * (c + u * e)) for a, b, c, e in self._cubics],
            [(b + u * (2.0 * c + 3.0 * u * e)) / t for _, b, c, e in self._cubics],
            [(2.0 * c + 6.0 * u * e) / (t * t) for _, _, c, e in self._cubics],
        )

"""How far along its path a movement is: speeding up, constant speed, slowing down."""

from __future__ import annotations

import math

__all__ = ["Profile", "timed"]


class Profile:
    """From rest to rest over a length, as fast as a speed and two accelerations let it: a trapezoid of the speed over
    time, or a triangle where the length is too short to reach the speed.

    Attributes:
        length: of the path, in whatever unit the speed and the accelerations have.
        duration: s.
        peak: the largest speed.
    """

    def __init__(self, length: float, speed: float, acceleration: float, rise: float | None = None) -> None:
        """`rise` is the acceleration of speeding up where that is another one than that of slowing down."""
        rise = acceleration if rise is None else rise
        # What speeding up and slowing down take of the length, per square of the speed.
        ramps = 0.5 / rise + 0.5 / acceleration
        peak = min(speed, math.sqrt(length / ramps))
        self.length, self.peak = length, peak
        self._rise, self._fall = rise, acceleration
        self._up = peak / rise
        cruise = max(length / peak - peak * ramps, 0.0) if peak > 0.0 else 0.0
        self._down = self._up + cruise
        self.duration = self._down + peak / acceleration

    def at(self, time: float) -> tuple[float, float, float]:
        """Way, speed and acceleration at a time in s from the start; at rest at the end from the end on."""
        if time >= self.duration:
            return self.length, 0.0, 0.0
        if time < self._up:
            return 0.5 * self._rise * time * time, self._rise * time, self._rise
        if time < self._down:
            return self.peak * (time - 0.5 * self._up), self.peak, 0.0
        left = self.duration - time
        return self.length - 0.5 * self._fall * left * left, self._fall * left, -self._fall


def timed(length: float, duration: float, speed: float, acceleration: float) -> tuple[float, float]:
    """The speed and the acceleration with which a length takes that many seconds, or as little more as the largest
    `speed` and `acceleration` allow.

    A third of the time each for speeding up, constant speed and slowing down, where the limits allow that; a
    controller's own choice is not known.
    """
    even = 1.5 * length / duration, 4.5 * length / duration**2
    if even[0] <= speed and even[1] <= acceleration:
        return even
    # At the largest acceleration, length / v + v / acceleration = duration.
    root = (acceleration * duration) ** 2 - 4.0 * acceleration * length
    if root < 0.0:
        return speed, acceleration
    return min(0.5 * (acceleration * duration - math.sqrt(root)), speed), acceleration

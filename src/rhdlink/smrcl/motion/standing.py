"""`stop` and `align`, and the generator of test signals, `funcgen`. `idle` is in `control`."""

from __future__ import annotations

import math
from collections.abc import Sequence

from ..arithmetic import divide, normalize_angle, sine, truncate
from .control import Drive, Motion, MotionControl, limited

__all__ = ["Align", "FunctionGenerator", "Stop"]


class Stop(Motion):
    """`stop`: hold the heading of the target."""

    def update(self, control: MotionControl) -> None:
        """Turn back by the error of the heading."""
        error = normalize_angle(control.target.th - control.pose.th)
        steering = control.parameters.gain * error
        if control.drive is Drive.VELOMEGA and control.profile.stop_stands:
            limit = control.parameters.limit
            control.left = control.right = 0.0
            control.omega = limited(steering, -limit, limit)
        else:
            # A velocity-omega robot takes the left one for its speed.
            control.left, control.right = -steering, steering

    def is_done(self, control: MotionControl) -> bool:
        """At once."""
        return True


class Align(Motion):
    """`align`: press the robot against an obstacle. A wheel that has stopped is told 4 m/s; its motor limits that."""

    #: m/s below which a wheel has stopped, and what it is told then.
    STOPPED = 0.01
    PRESSING = 4.0

    def update(self, control: MotionControl) -> None:
        """Drive both wheels."""
        control.target = control.pose.copy()
        control.set_wheels(
            self.PRESSING if abs(control.left_velocity) < self.STOPPED else control.speed,
            self.PRESSING if abs(control.right_velocity) < self.STOPPED else control.speed,
        )


class FunctionGenerator(Motion):
    """`funcgen`: a signal for a variable of the robot that `routeoutput` names; the speeds stay what they are.

    Args:
        parameters: 0 for a step (then height, s until it begins, s that it lasts), 1 for a square wave and 2 for a sine
            (amplitude, Hz, s), 3 for a sweep (rate of change, Hz at the begin and at the end in rad/s, s).

    Attributes:
        output: the present value.
    """

    _PERIOD = 0.01

    def __init__(self, parameters: Sequence[float]) -> None:
        self._parameters = tuple(parameters)
        self.output = 0.0
        self._is_over = False

    def update(self, control: MotionControl) -> None:
        """The next value."""
        kind, first, second, third, fourth = self._parameters
        number, cycles, period = truncate(kind), control.cycles, self._PERIOD
        if number == 0:
            begin = second / period
            end = third / period + begin
            self._is_over = cycles > end
            if not self._is_over:
                self.output = first if begin <= cycles < end else 0.0
        elif number in (1, 2, 3):
            self._is_over = cycles >= (fourth if number == 3 else third) / period
            if self._is_over:
                return
            if number == 1:
                half = divide(1.0, second) * 0.5
                halves = divide(cycles * period, half) - 0.5
                # C's round: halves away from zero.
                is_odd = math.isfinite(halves) and math.floor(abs(halves) + 0.5) % 2 == 1
                self.output = first if is_odd else -first
            elif number == 2:
                self.output = first * sine(divide(math.tau * (cycles * period), divide(1.0, second)))
            else:
                squared = cycles * period * cycles * period
                self.output = sine(second * cycles * period + (third - second) / 2 * first * squared)

    def is_done(self, control: MotionControl) -> bool:
        """When the signal is over."""
        return self._is_over

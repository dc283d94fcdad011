"""A driven wheel of the simulated robot: motor, friction and speed control, as in the log of a robot.

The controller is the one in the `robot.ini` of the log: a PI controller with 7 V per m/s, an integral time of 0.05 s
and at most 8 V. The other numbers were fitted to the log of 2025-01-31, in which the robot drives with ``rc 0.1 0.5``
for 10 s:

==========================================  ==============  ================
quantity                                    log             simulated
==========================================  ==============  ================
mean speed, left and right, m/s             0.045, 0.155    0.045, 0.155
standard deviation of the speed, m/s        0.029, 0.021    0.024, 0.025
mean voltage, left and right, V             0.51, 1.10      0.50, 1.10
correlation of the speed after 20 ms        0.49, 0.16      0.48, 0.49
first movement after ``rc 0.25 0``, ms      24              25
largest speed in the next 0.3 s, m/s        0.31            0.28
largest speed in the first 60 ms, m/s       0.31            0.20
==========================================  ==============  ================

So the simulated wheels start more slowly than the real ones, probably because their gears have play.
"""

from __future__ import annotations

import math
from collections import deque
from random import Random

#: Duration of a step of the simulation, in s.
STEP = 0.001
#: Gain in V per m/s, integral time in s, and largest voltage (`robot.ini`).
_GAIN, _INTEGRAL_TIME, _MOST_VOLTS = 7.0, 0.05, 8.0
#: Voltage per m/s, and voltages that overcome friction while the wheel turns and while it is at rest (fitted).
_VOLTS_PER_SPEED, _SLIDING, _STICKING = 5.4, 0.26, 0.5
#: Time constant of the motor, delay of a command, and delay of the measured speed, in s (fitted).
_TIME_CONSTANT, _COMMAND_DELAY, _MEASURE_DELAY = 0.035, 0.02, 0.012
#: Standard deviation of the load in V, and its time constant in s (fitted): gears, tyres and floor.
_LOAD, _LOAD_TIME = 0.33, 0.02
#: Speed below which a wheel is at rest, and below which a wheel with the target 0 is released, in m/s.
_REST, _RELEASE = 1e-3, 0.02


class Wheel:
    """A driven wheel.

    Args:
        random: Source of the changes of the load; None for a constant load.

    Attributes:
        speed: Speed in m/s.
        volts: Voltage of the motor, in V.
        target: Wanted speed in m/s.
        is_on: Whether the motor is controlled. Otherwise it has no voltage.
    """

    def __init__(self, random: Random | None = None) -> None:
        self.speed = 0.0
        self.volts = 0.0
        self.target = 0.0
        self.is_on = False
        self._random = random
        self._load = 0.0
        self._integral = 0.0
        self._targets = deque([0.0] * round(_COMMAND_DELAY / STEP))
        self._measured = deque([0.0] * round(_MEASURE_DELAY / STEP))

    def step(self) -> None:
        """Advance by `STEP`."""
        self._targets.append(self.target if self.is_on else 0.0)
        target, measured = self._targets.popleft(), self._measured.popleft()
        if not self.is_on or (target == 0.0 and abs(measured) < _RELEASE):
            self._integral = self.volts = 0.0
        else:
            error = target - measured
            self._integral += _GAIN / _INTEGRAL_TIME * error * STEP
            self._integral = max(-_MOST_VOLTS, min(_MOST_VOLTS, self._integral))
            self.volts = max(-_MOST_VOLTS, min(_MOST_VOLTS, _GAIN * error + self._integral))
        self._turn()
        self._measured.append(self.speed)

    def _turn(self) -> None:
        if self._random is not None:
            change = self._random.gauss(0.0, _LOAD * math.sqrt(2 * STEP / _LOAD_TIME))
            self._load += change - self._load * STEP / _LOAD_TIME
        # The load resists only a motor that has a voltage: a robot that is off does not move.
        drive = self.volts + (self._load if self.volts else 0.0)
        if abs(self.speed) < _REST and abs(drive) < _STICKING:
            self.speed = 0.0
            return
        direction = math.copysign(1.0, self.speed or drive)
        speed = self.speed
        speed += ((drive - direction * _SLIDING) / _VOLTS_PER_SPEED - speed) / _TIME_CONSTANT * STEP
        self.speed = 0.0 if speed * self.speed < 0.0 else speed

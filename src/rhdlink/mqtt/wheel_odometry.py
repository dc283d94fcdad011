"""Distance and heading of a robot, from its poses or from the speeds of its wheels.

Poses are used if the robot publishes them. The robot in the log does not, so its wheel speeds are integrated, with the
time of the Teensy. Each pose or speed counts, and not only the newest one of a tick.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

#: Distance between the wheels in m, until the robot reports another one: the value that the course's client sets.
WHEEL_BASE = 0.23
#: Longest time between two messages that is integrated, in s. After a longer interruption, counting begins again.
_LONGEST = 0.5
#: Fastest plausible movement, in m/s and rad/s. A faster pose has been reset, for example by the command enc0.
_FASTEST_MOVE, _FASTEST_TURN = 10.0, 50.0


class Odometry:
    """Travelled distance and heading.

    Attributes:
        distance: Travelled distance, in m.
        heading: Heading, in rad, not wrapped.
        base: Distance between the wheels, in m.
    """

    def __init__(self) -> None:
        self.distance = 0.0
        self.heading = 0.0
        self.base = WHEEL_BASE
        self._pose: tuple[float, float, float, float] | None = None
        self._wheels: tuple[float, float, float] | None = None

    def take_pose(self, values: Mapping[str, Any]) -> None:
        """Process the values of a message ``pose``."""
        new = values["posetime"], values["posex"], values["posey"], values["heading"]
        old, self._pose = self._pose, new
        if old is None:
            return
        seconds = new[0] - old[0]
        turn = math.remainder(new[3] - old[3], 2 * math.pi)
        forward = (new[1] - old[1]) * math.cos(new[3]) + (new[2] - old[2]) * math.sin(new[3])
        move = math.hypot(new[1] - old[1], new[2] - old[2])
        if seconds > 0.0 and move <= _FASTEST_MOVE * seconds and abs(turn) <= _FASTEST_TURN * seconds:
            self.distance += forward
            self.heading += turn

    def take_wheels(self, values: Mapping[str, Any]) -> bool:
        """Process the values of a message ``vel``. Return False if poses are used instead."""
        if self._pose is not None:
            return False
        new = values["veltime"], values["velleft"], values["velright"]
        old, self._wheels = self._wheels, new
        if old is not None and 0.0 < (seconds := new[0] - old[0]) <= _LONGEST:
            left, right = 0.5 * (old[1] + new[1]) * seconds, 0.5 * (old[2] + new[2]) * seconds
            self.distance += 0.5 * (left + right)
            self.heading += (right - left) / self.base
        return True

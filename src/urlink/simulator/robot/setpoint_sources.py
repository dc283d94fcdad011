"""The sources of the arm's set-points, cycle by cycle.

A controller begins with `Still` or another source that it is given; a program that runs is a source as well.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple, Protocol

from linkcore.errors import BadValue
from urlink.arm.parameters import number

#: rad. Elbow up, tool pointing down, in the middle of the workspace: far from the joint limits and from every singular
#: posture of every model. On a UR5e or a larger arm, circles of 0.25 m radius that begin here to either side,
#: horizontal or upright, pass none either.
HOME = (0.0, -1.5, 2.0, -0.5 - math.pi / 2, -math.pi / 2, 0.0)

#: Fraction of the largest joint acceleration with which an arm brakes if no program commands it. How hard a controller
#: brakes is not published; this is a cautious guess.
BRAKING = number("braking_share")

#: Six zeros, for the speeds and the accelerations of an arm at rest. Many set-points share this list: never change it.
REST = [0.0] * 6


class Setpoint(NamedTuple):
    """The targets of one cycle, joints from base to wrist 3: six positions in rad, speeds in rad/s, accelerations in
    rad/s²."""

    q: list[float]
    qd: list[float]
    qdd: list[float]


class SetpointSource(Protocol):
    """A source of set-points. In each controller cycle in which the arm may move, it gives one.

    After a stop the arm stands somewhere along its brake path; `start` passes that position.

    Attributes:
        is_program: whether following this source counts as a running program.
    """

    is_program: bool

    def start(self, q: Sequence[float]) -> None:
        """Begin, from rest, at six joint positions in rad."""

    def advance(self, seconds: float) -> Setpoint:
        """The set-point after a cycle of `seconds`."""


class Still:
    """The arm stands still, in six joint positions in rad, and no program runs.

    Raises:
        BadValue: not six finite numbers.
    """

    is_program = False

    def __init__(self, q: Sequence[float] = HOME) -> None:
        self.start(_posture(q))

    def start(self, q: Sequence[float]) -> None:
        """Stand at six joint positions in rad."""
        self._setpoint = Setpoint(list(q), REST, REST)

    def advance(self, seconds: float) -> Setpoint:
        """Always the same set-point."""
        return self._setpoint


class Demonstration:
    """Slow sine waves about a home posture, from rest, after a straight joint movement there if necessary.

    No joint goes faster than 0.45 rad/s or accelerates by more than 0.7 rad/s², a small part of what any model can do.
    Joint speeds are continuous; accelerations are too, once the movement to the home posture is over.

    Raises:
        BadValue: the home posture is not six finite numbers.
    """

    is_program = True

    #: seconds after which the waves repeat
    PERIOD = 12.0
    #: rad, one per joint
    AMPLITUDES = (0.6, 0.15, 0.25, 0.2, 0.2, 0.5)
    #: waves per period
    WAVES = (1, 2, 1, 2, 3, 1)
    #: seconds in which the waves grow to their full speed
    RAMP = 2.0
    #: rad/s, the largest joint speed on the way to the home posture
    APPROACH_SPEED = 0.45
    #: seconds that the way to the home posture takes at least
    APPROACH_LEAST = 2.0

    def __init__(self, home: Sequence[float] = HOME) -> None:
        self._home = _posture(home)
        self._waves = [
            (h, a, 2.0 * math.pi * n / self.PERIOD) for h, a, n in zip(home, self.AMPLITUDES, self.WAVES, strict=True)
        ]
        self.start(home)

    def start(self, q: Sequence[float]) -> None:
        """Begin, from rest, at six joint positions in rad."""
        self._time = 0.0
        self._way = [h - start for h, start in zip(self._home, q, strict=True)]
        furthest = max(map(abs, self._way))
        # The fastest point of the quintic is 15/8 of its mean speed.
        self._approach = max(1.875 * furthest / self.APPROACH_SPEED, self.APPROACH_LEAST) if furthest > 1e-9 else 0.0

    def advance(self, seconds: float) -> Setpoint:
        """The set-point `seconds` later."""
        self._time += seconds
        if self._time < self._approach:
            return self._approaching()
        return self._waving(self._time - self._approach)

    def _approaching(self) -> Setpoint:
        u = self._time / self._approach
        rest = 1.0 - u
        # The rest of the way: one minus the quintic that starts and ends without speed and acceleration.
        left = rest**3 * (1.0 + 3.0 * u + 6.0 * u * u)
        speed = 30.0 * u * u * rest * rest / self._approach
        acceleration = 60.0 * u * rest * (1.0 - 2.0 * u) / self._approach**2
        return Setpoint(
            [h - left * way for h, way in zip(self._home, self._way, strict=True)],
            [speed * way for way in self._way],
            [acceleration * way for way in self._way],
        )

    def _waving(self, time: float) -> Setpoint:
        if time < self.RAMP:
            u = time / self.RAMP
            phase = self.RAMP * u**3 * (1.0 - 0.5 * u)
            scaling = u * u * (3.0 - 2.0 * u)
            change = 6.0 * u * (1.0 - u) / self.RAMP
        else:
            phase, scaling, change = time - 0.5 * self.RAMP, 1.0, 0.0
        q, qd, qdd = [], [], []
        for home, amplitude, omega in self._waves:
            wave = amplitude * math.sin(omega * phase)
            slope = amplitude * omega * math.cos(omega * phase)
            q.append(home + wave)
            qd.append(slope * scaling)
            qdd.append(slope * change - omega * omega * wave * scaling * scaling)
        return Setpoint(q, qd, qdd)


def _posture(q: Sequence[float]) -> list[float]:
    values = [float(value) for value in q]
    if len(values) != 6 or not all(map(math.isfinite, values)):
        raise BadValue(f"a posture is six finite numbers in rad, not {q!r}")
    return values

"""Sources of set-points for the arm, one set-point per cycle.

A new controller uses `Still` or another given source. A running program is also a source.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple, Protocol

from linkcore.errors import BadValue
from urlink.arm.parameters import number
from urlink.arm.vectors import FloatArray

#: Default posture, in rad: elbow up, tool pointing down, in the middle of the workspace. The posture is far from the
#: joint limits and from every singular posture of every model. On a UR5e or a larger arm, a circle with a radius of
#: 0.25 m that begins at this posture passes no singular posture either. This holds for horizontal and for upright
#: circles, to either side.
HOME = (0.0, -1.5, 2.0, -0.5 - math.pi / 2, -math.pi / 2, 0.0)

#: Deceleration of an arm that no program commands, as a fraction of the maximum joint acceleration. The deceleration of
#: a real controller is not published; this is a cautious assumption.
BRAKING = number("braking_share")

#: Six zeros: the speeds or the accelerations of an arm at rest. Many set-points share this list, so never change it.
REST = [0.0] * 6


class Setpoint(NamedTuple):
    """Targets of one cycle for the six joints, from base to wrist 3.

    A set-point consists of six positions in rad, six speeds in rad/s and six accelerations in rad/s².
    """

    q: list[float]
    qd: list[float]
    qdd: list[float]


class Course:
    """Set-points of several cycles in a row. Each one is made when it is read.

    Args:
        first: Set-point of the first cycle.
        then: Positions, speeds and accelerations of the following cycles, shape (3, n, 6), in rad, rad/s and rad/s².
            None if the arm is at rest, so that all set-points equal the first one.
    """

    def __init__(self, first: Setpoint, then: FloatArray | None = None) -> None:
        self._first, self._then = first, then

    def __getitem__(self, at: int) -> Setpoint:
        if at == 0 or self._then is None:
            return self._first
        return Setpoint(*self._then[:, at - 1].tolist())


class SetpointSource(Protocol):
    """Source of set-points, which returns one set-point for each controller cycle while the arm may move.

    After a stop, the arm is at rest at the end of its brake path; `start` receives this position.

    Attributes:
        is_program: Whether the controller reports a running program while the arm follows this source.
    """

    is_program: bool

    def start(self, q: Sequence[float]) -> None:
        """Begin from rest at six joint positions, in rad."""

    def advance(self, seconds: float) -> Setpoint:
        """Return the set-point one cycle of `seconds` later."""


class Still:
    """Source that holds the arm at six joint positions, in rad. It does not count as a program.

    Raises:
        BadValue: If `q` is not six finite numbers.
    """

    is_program = False

    def __init__(self, q: Sequence[float] = HOME) -> None:
        self.start(_posture(q))

    def start(self, q: Sequence[float]) -> None:
        """Hold the arm at six joint positions, in rad."""
        self._setpoint = Setpoint(list(q), REST, REST)

    def advance(self, seconds: float) -> Setpoint:
        """Return the set-point, which is always the same."""
        return self._setpoint


class Demonstration:
    """Source that moves the joints in slow sine waves around a home posture, starting from rest.

    If the arm is not in the home posture, a straight joint motion moves it there first. No joint moves faster than 0.45
    rad/s or accelerates by more than 0.7 rad/s², a small fraction of the limits of any model. The joint speeds are
    continuous. After the motion to the home posture has ended, the accelerations are continuous too.

    Raises:
        BadValue: If the home posture is not six finite numbers.
    """

    is_program = True

    #: Period of the waves, in s.
    PERIOD = 12.0
    #: Amplitude of each joint, in rad.
    AMPLITUDES = (0.6, 0.15, 0.25, 0.2, 0.2, 0.5)
    #: Number of waves per period, for each joint.
    WAVES = (1, 2, 1, 2, 3, 1)
    #: Time in which the waves reach their full speed, in s.
    RAMP = 2.0
    #: Maximum joint speed of the motion to the home posture, in rad/s.
    APPROACH_SPEED = 0.45
    #: Minimum duration of the motion to the home posture, in s.
    APPROACH_LEAST = 2.0

    def __init__(self, home: Sequence[float] = HOME) -> None:
        self._home = _posture(home)
        self._waves = [
            (h, a, 2.0 * math.pi * n / self.PERIOD) for h, a, n in zip(home, self.AMPLITUDES, self.WAVES, strict=True)
        ]
        self.start(home)

    def start(self, q: Sequence[float]) -> None:
        """Begin from rest at six joint positions, in rad."""
        self._time = 0.0
        self._way = [h - start for h, start in zip(self._home, q, strict=True)]
        furthest = max(map(abs, self._way))
        # The maximum speed on the quintic polynomial is 15/8 of the mean speed.
        self._approach = max(1.875 * furthest / self.APPROACH_SPEED, self.APPROACH_LEAST) if furthest > 1e-9 else 0.0

    def advance(self, seconds: float) -> Setpoint:
        """Return the set-point `seconds` later."""
        self._time += seconds
        if self._time < self._approach:
            return self._approaching()
        return self._waving(self._time - self._approach)

    def _approaching(self) -> Setpoint:
        u = self._time / self._approach
        rest = 1.0 - u
        # Remaining fraction of the distance: one minus the quintic polynomial that starts and ends with zero speed and
        # acceleration.
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
        raise BadValue(f"the posture is {q!r}; expected six finite numbers in rad")
    return values

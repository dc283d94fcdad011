"""Simulated robots in a walled square, with which programs can be tested without hardware.

`Turtle` is a velocity-omega robot. `SmrTurtle` is an SMR, which is driven by the speeds of its wheels. MRC expects
their variables and scales. Both robots stop when their last writer disconnects; in the original, each plugin decides
this. They do not move again until new values are written, because a master that is killed does not send zeros.
"""

from __future__ import annotations

import math

import numpy as np

from linkcore.errors import BadValue

from ...variables.declarations import Read, Write
from ...variables.value_types import Int32, wrapped
from ..config import Element
from ..plugin import Plugin
from ..world import World

#: Positions of the SMR's line sensors, in m: distance in front of the robot's centre, and distance to the left for each
#: sensor. The spacing is from MRC, which uses 2 cm for each sensor (linesensor.c). The distance of 21 cm is from MRC's
#: test of `followline`.
_LINE_AHEAD = 0.21
_LINE_ASIDE = tuple(0.02 * (number - 3.5) for number in range(8))
#: Raw values of the line sensors on black and on white.
_BLACK, _WHITE = 25.0, 230.0

#: Directions of the SMR's distance sensors, in rad: left, front left, front middle, front right, right.
_DIRECTIONS = tuple(map(math.radians, (90.0, 22.5, 0.0, -22.5, -90.0)))


class _InWorld(Plugin):
    """Base class of the two turtles.

    Args:
        world: World to drive in; by default 11 x 11 m, with the start in the middle.
        needs_master: Whether to stop when no client may write.
    """

    def __init__(self, world: World | None = None, *, needs_master: bool = True) -> None:
        if world is not None and not isinstance(world, World):
            raise BadValue(f"world={world!r}; expected rhdlink.host.world.World(...)")
        self.world = World() if world is None else world
        self._has_world = world is not None
        self._needs_master = needs_master
        self._is_commanded = not needs_master

    def init(self, config: Element) -> None:
        """Read `size`, `x`, `y` (m) and `theta` (rad) of the world from the file, unless a world was given."""
        if self._has_world:
            return
        # These bounds only reject implausible values in a file.
        size = config.number("size", self.world.size, least=0.1, most=1e6)
        x, y = (config.number(name, size / 2, least=0.0, most=size) for name in "xy")
        self.world = World(size, (x, y, config.number("theta", 0.0)))

    def _obeys(self, was_written: bool) -> bool:
        """Whether the current command must be executed."""
        # Values from the previous master must not move the robot. The new master has to write first.
        if self._needs_master:
            if not self.host.writers:
                self._is_commanded = False
            elif was_written:
                self._is_commanded = True
        return self._is_commanded


class Turtle(_InWorld):
    """Simulated velocity-omega robot in a square world.

    Args:
        world: World to drive in; by default 11 x 11 m, with the start in the middle.
        needs_master: Whether to stop when no client may write.
        linear_scale: Counts of `transpos` per m, and of `cmdtransvel` per m/s.
        angular_scale: Counts of `rotpos` per rad, and of `cmdrotvel` per rad/s.

    Raises:
        BadValue: If a scale is not positive.
    """

    cmdtransvel = Write(Int32, unit="1e-5 m/s", doc="forward velocity")
    cmdrotvel = Write(Int32, unit="rad/s / 40000", doc="turn rate, to the left")
    transpos = Read(Int32, unit="1e-5 m", doc="travelled distance")
    rotpos = Read(Int32, unit="rad / 40000", doc="heading, not wrapped")

    def __init__(
        self,
        world: World | None = None,
        *,
        needs_master: bool = True,
        linear_scale: float = 1e5,
        angular_scale: float = 4e4,
    ) -> None:
        super().__init__(world, needs_master=needs_master)
        if not (0.0 < linear_scale < math.inf and 0.0 < angular_scale < math.inf):
            raise BadValue(f"the scales are {linear_scale} and {angular_scale}; expected positive numbers")
        self._linear, self._angular = linear_scale, angular_scale
        self._travelled = 0.0

    def periodic(self, tick: int) -> None:
        """Drive for one period."""
        was_written = self.is_updated(Turtle.cmdtransvel) or self.is_updated(Turtle.cmdrotvel)
        linear = angular = 0.0
        if self._obeys(was_written):
            linear, angular = self.cmdtransvel / self._linear, self.cmdrotvel / self._angular
        self._travelled += self.world.step(linear, angular, self.host.period).distance
        self.transpos = wrapped(self._travelled * self._linear)
        self.rotpos = wrapped(self.world.odometry.theta * self._angular)


class SmrTurtle(_InWorld):
    """Simulated SMR in a square world, with two wheels, encoders, line sensors and distance sensors.

    The raw value of a distance sensor is ``16 / m + 76``, the same as in MRC without calibration. The sensors are in
    the middle of the robot.

    Args:
        world: World to drive in; by default 11 x 11 m, with the start in the middle.
        needs_master: Whether to stop when no client may write.
        width: Distance between the wheels, in m.
        tick_length: Travel of a wheel for one tick of its encoder, in m.
        encoder_bits: 32, or 16 for counters that wrap as in the real robot. MRC treats each wrap of a 16-bit counter
            as an odometry error.

    Raises:
        BadValue: If a size is not positive, or `encoder_bits` is invalid.
    """

    speedl = Write(Int32, unit="cm/s", doc="speed of the left wheel, -127..127")
    speedr = Write(Int32, unit="cm/s", doc="speed of the right wheel, -127..127")
    resetmotorl = Write(Int32, doc="accepted, and without effect")
    resetmotorr = Write(Int32, doc="accepted, and without effect")
    encl = Read(Int32, unit="ticks", doc="left encoder")
    encr = Read(Int32, unit="ticks", doc="right encoder")
    linesensor = Read(Int32, 8, doc="raw brightness, 25 on black and 230 on white; 128 if the floor is unknown")
    irsensor = Read(Int32, 6, doc="raw distances: left, front left, front middle, front right, right, unused")

    def __init__(
        self,
        world: World | None = None,
        *,
        needs_master: bool = True,
        width: float = 0.26,
        tick_length: float = 0.00010245,
        encoder_bits: int = 32,
    ) -> None:
        super().__init__(world, needs_master=needs_master)
        if not (0.0 < width < math.inf and 0.0 < tick_length < math.inf):
            raise BadValue(f"width={width} m and tick_length={tick_length} m; expected positive numbers")
        if encoder_bits not in (16, 32):
            raise BadValue(f"encoder_bits={encoder_bits}; expected 16 or 32")
        self._width = width
        self._tick_length = tick_length
        self._encoder_bits = encoder_bits
        self._left = self._right = 0.0

    def init(self, config: Element) -> None:
        """Read the world from the file, unless a world was given."""
        super().init(config)
        self.linesensor = [128] * 8

    def periodic(self, tick: int) -> None:
        """Drive for one period."""
        was_written = self.is_updated(SmrTurtle.speedl) or self.is_updated(SmrTurtle.speedr)
        left = right = 0.0
        if self._obeys(was_written):
            left, right = 0.01 * _limited(self.speedl), 0.01 * _limited(self.speedr)
        seconds = self.host.period
        linear, angular = (left + right) / 2, (right - left) / self._width
        moved = self.world.step(linear, angular, seconds)
        if moved.is_blocked:
            # The wheels turn only as far as the robot moved.
            turned = moved.angle * self._width / 2
            self._left += moved.distance - turned
            self._right += moved.distance + turned
        else:
            self._left += left * seconds
            self._right += right * seconds
        self.encl = wrapped(self._left / self._tick_length, self._encoder_bits)
        self.encr = wrapped(self._right / self._tick_length, self._encoder_bits)
        if self.world.scene is not None:
            seen = self.world.brightness(_LINE_AHEAD, _LINE_ASIDE)
            self.linesensor = np.rint(_BLACK + (_WHITE - _BLACK) * seen).astype(np.int32)
        self.irsensor = [*(_raw(self.world.wall(direction)) for direction in _DIRECTIONS), 0]


def _limited(speed: int) -> int:
    # The driver has 8 bits for the speed (docs/protocols/rhd.md, Names of variables). The recorded drives show that it
    # limits the speed, rather than wrapping it.
    return max(-127, min(127, speed))


def _raw(distance: float) -> int:
    return 255 if distance < 16.0 / 179.0 else round(16.0 / distance + 76.0)

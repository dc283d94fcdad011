"""`Turtle`: a simulated robot in a walled square, for trying everything without hardware.

`Turtle` is driven as a velocity-omega robot, `SmrTurtle` as an SMR, by the speeds of its wheels; variables and scales
are those that MRC expects. Both stop when their last writer goes away, which the original leaves to each plugin, and do
not start again before they are written again: a master that is killed ends no connection in order.
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

#: The SMR's line sensors: m before the robot's middle, and m to the left of it, of each. How far apart they are follows
#: from MRC, which takes 2 cm for each (linesensor.c); that they are 21 cm ahead from its test of `followline`.
_LINE_AHEAD = 0.21
_LINE_ASIDE = tuple(0.02 * (number - 3.5) for number in range(8))
#: Their raw values on black and on white.
_BLACK, _WHITE = 25.0, 230.0

#: Directions of the SMR's distance sensors, rad: left, front left, front middle, front right, right.
_DIRECTIONS = tuple(map(math.radians, (90.0, 22.5, 0.0, -22.5, -90.0)))


class _InWorld(Plugin):
    """The common part of the two turtles.

    Args:
        world: to be driven in; an 11 x 11 m one, from its middle, by default.
        needs_master: whether to stop when no client may write.
    """

    def __init__(self, world: World | None = None, *, needs_master: bool = True) -> None:
        if world is not None and not isinstance(world, World):
            raise BadValue(f"world={world!r}; expected rhdlink.host.world.World(...)")
        self.world = World() if world is None else world
        self._has_world = world is not None
        self._needs_master = needs_master
        self._is_commanded = not needs_master

    def init(self, config: Element) -> None:
        """Take `size`, `x`, `y` (m) and `theta` (rad) of the world from the file, unless there is one."""
        if self._has_world:
            return
        # The bounds only refuse nonsense in a file.
        size = config.number("size", self.world.size, least=0.1, most=1e6)
        x, y = (config.number(name, size / 2, least=0.0, most=size) for name in "xy")
        self.world = World(size, (x, y, config.number("theta", 0.0)))

    def _obeys(self, was_written: bool) -> bool:
        """Whether the command is in force."""
        # A new master does not set it moving by the values of the one before: it has to write first.
        if self._needs_master:
            if not self.host.writers:
                self._is_commanded = False
            elif was_written:
                self._is_commanded = True
        return self._is_commanded


class Turtle(_InWorld):
    """A velocity-omega robot in a square world.

    Args:
        world: to be driven in; an 11 x 11 m one, from its middle, by default.
        needs_master: whether to stop when no client may write.
        linear_scale: counts per m, of `transpos`, and per m/s, of `cmdtransvel`.
        angular_scale: counts per rad, of `rotpos`, and per rad/s, of `cmdrotvel`.

    Raises:
        BadValue: a scale that is not positive.
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
            raise BadValue(f"scales of {linear_scale} and {angular_scale}; expected positive numbers")
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
    """An SMR in a square world: two wheels, their encoders, and the distances to the walls.

    The distance sensors are of the kind whose raw value is ``16 / m + 76``, as MRC has it unless it is calibrated, and
    sit in the middle of the robot.

    Args:
        world: to be driven in; an 11 x 11 m one, from its middle, by default.
        needs_master: whether to stop when no client may write.
        width: between the wheels, m.
        tick_length: travel of a wheel for one tick of its encoder, m.
        encoder_bits: 32, or 16 for counters that wrap as those of the real robot do; MRC takes each wrap of the latter
            as an odometry error.

    Raises:
        BadValue: sizes that are not positive, or other counters.
    """

    speedl = Write(Int32, unit="cm/s", doc="speed of the left wheel, -127..127")
    speedr = Write(Int32, unit="cm/s", doc="speed of the right wheel, -127..127")
    resetmotorl = Write(Int32, doc="accepted, and without effect")
    resetmotorr = Write(Int32, doc="accepted, and without effect")
    encl = Read(Int32, unit="ticks", doc="left encoder")
    encr = Read(Int32, unit="ticks", doc="right encoder")
    linesensor = Read(Int32, 8, doc="raw brightness, 25 on black and 230 on white; 128 where the floor is not known")
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
            raise BadValue(f"width {width} m and tick length {tick_length} m; expected positive numbers")
        if encoder_bits not in (16, 32):
            raise BadValue(f"encoders of {encoder_bits} bits; expected 16 or 32")
        self._width = width
        self._tick_length = tick_length
        self._encoder_bits = encoder_bits
        self._left = self._right = 0.0

    def init(self, config: Element) -> None:
        """Take the world from the file, unless there is one."""
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
            # The wheels turn as far as the robot went.
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
    # The driver has 8 bits for it (docs/protocols/rhd.md, Names of variables), and the recorded drives show that
    # it limits rather than wraps.
    return max(-127, min(127, speed))


def _raw(distance: float) -> int:
    return 255 if distance < 16.0 / 179.0 else round(16.0 / distance + 76.0)

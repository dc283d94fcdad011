"""The bridge between a velocity-omega robot and whatever drives it: velocities out, poses in, as plain calls.

A program that writes `cmdtransvel` and `cmdrotvel`, MRC for one, commands a `Twist`. A robot whose poses are given
to `update_pose` sends that program its `transpos` and `rotpos`, which an `Odometer` counts.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from typing import NamedTuple

from linkcore.arguments import check_callable
from linkcore.errors import BadValue
from linkcore.streaming.packet_queue import PacketQueue, latest
from linkcore.streaming.statistics import SubscriptionStatistics
from linkcore.streaming.subscription import ThreadedDelivery

from ...variables.declarations import Read, Write
from ...variables.value_types import Int32, wrapped
from ..config import Element
from ..plugin import Plugin


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


#: m/s below which a forward velocity is taken for none.
DEAD_BAND = 0.005
#: Metres, or rad, beyond which a pose is a mistake; and poses that wait for a tick.
_FARTHEST = 1e6
_MOST_POSES = 1000


class Twist(NamedTuple):
    """A velocity: forward in m/s, and turning to the left in rad/s."""

    linear: float
    angular: float


class VelocityBridge(Plugin):
    """Hands velocities to a function, and takes poses.

    The function is called when a program has written another velocity than before, and with none when the last program
    that may write has gone. It runs in a thread of its own: it may take its time, the tick does not wait, and of the
    velocities that come meanwhile the newest is handed over next. What it raises is logged and counted.

    Args:
        on_twist: is given each new `Twist`.
        command_linear_scale: of `cmdtransvel`, per m/s.
        command_angular_scale: of `cmdrotvel`, per rad/s.
        linear_scale: counts of `transpos` per m.
        angular_scale: counts of `rotpos` per rad.
        dead_band: m/s below which a forward velocity is taken for none.
        needs_master: whether to hand over none when no client may write.
        own_thread: False calls the function in the host's, for lockstep: the same each time.

    Raises:
        BadValue: a scale or a dead band that cannot be.
    """

    cmdtransvel = Write(Int32, unit="1e-5 m/s", doc="forward velocity")
    cmdrotvel = Write(Int32, unit="rad/s / 40000", doc="turn rate, to the left")
    transpos = Read(Int32, unit="1e-5 m", doc="travelled distance")
    rotpos = Read(Int32, unit="rad / 40000", doc="heading")

    def __init__(
        self,
        on_twist: Callable[[Twist], object],
        *,
        command_linear_scale: float = 1e5,
        command_angular_scale: float = 4e4,
        linear_scale: float = 1e5,
        angular_scale: float = 4e4,
        dead_band: float = DEAD_BAND,
        needs_master: bool = True,
        own_thread: bool = True,
    ) -> None:
        check_callable(on_twist, "on_twist")
        for scale in (command_linear_scale, command_angular_scale):
            if not math.isfinite(scale) or scale == 0.0:
                raise BadValue(f"{scale} is no scale of a command")
        if not 0.0 <= dead_band < math.inf:
            raise BadValue(f"dead_band is {dead_band}; expected 0 or more m/s")
        self._on_twist = on_twist
        self._scales = command_linear_scale, command_angular_scale
        self._odometer = Odometer(linear_scale, angular_scale)
        self._dead_band = dead_band
        self._needs_master = needs_master
        self._own_thread = own_thread
        self._queue = PacketQueue(latest)
        self._delivery: ThreadedDelivery | None = None
        self._poses: deque[tuple[float, float, float]] = deque(maxlen=_MOST_POSES)
        self._last = Twist(0.0, 0.0)  # the robot stands

    @property
    def stats(self) -> SubscriptionStatistics | None:
        """Counters of velocities; None before `init`, and without an own thread."""
        return None if self._delivery is None else self._delivery.statistics

    def update_pose(self, x: float, y: float, theta: float) -> None:
        """Set the pose of the robot: m, m, rad. From any thread; programs receive it at the next tick.

        Raises:
            BadValue: not finite, or beyond 1000 km or a million rad.
        """
        if not all(abs(value) <= _FARTHEST for value in (x, y, theta)):
            raise BadValue(f"{x}, {y}, {theta} is no pose: expected numbers up to {_FARTHEST:g}")
        self._poses.append((float(x), float(y), float(theta)))

    def init(self, config: Element) -> None:
        """Start the thread of the function."""
        if self._own_thread:
            self._delivery = ThreadedDelivery(self._queue, self._on_twist, name=f"rhdlink {self.name}")

    def periodic(self, tick: int) -> None:
        """Hand over a new velocity, and tell the poses that have come."""
        poses, odometer = self._poses, self._odometer
        if poses:
            # Every one of them, in order: the path between two poses counts, and not only the last place. As many as
            # there are now, since another thread may go on adding.
            for _ in range(len(poses)):
                odometer.update(*poses.popleft())
            self.transpos, self.rotpos = odometer.transpos, odometer.rotpos
        # A master that is killed sends no zeros (docs/protocols/rhd.md, How MRC uses a host).
        if self._needs_master and not self.host.writers:
            self._hand_over(Twist(0.0, 0.0))
        elif self.is_updated(VelocityBridge.cmdtransvel) or self.is_updated(VelocityBridge.cmdrotvel):
            self._hand_over(self._commanded())

    def terminate(self) -> None:
        """Hand over no velocity, and wait for the function to take it."""
        self._hand_over(Twist(0.0, 0.0))
        if self._delivery is not None:
            self._delivery.finish()

    def _commanded(self) -> Twist:
        # Only the forward velocity has a dead band.
        linear = self.cmdtransvel / self._scales[0]
        return Twist(0.0 if abs(linear) < self._dead_band else linear, self.cmdrotvel / self._scales[1])

    def _hand_over(self, twist: Twist) -> None:
        if twist == self._last:
            return
        self._last = twist
        if self._own_thread:
            self._queue.offer([twist])
        else:
            self._on_twist(twist)

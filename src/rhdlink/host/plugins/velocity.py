"""Bridge between RHD programs and a velocity-omega robot. Velocities and poses are passed with function calls.

Programs such as MRC write `cmdtransvel` and `cmdrotvel`, and the bridge converts these to a `Twist`. The poses of the
robot are passed to `update_pose`. An `Odometer` converts the poses to `transpos` and `rotpos`, which the program reads.
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
    """Converter from poses to `transpos` and `rotpos`.

    For each pose, the displacement since the last pose is projected on the heading, ``dx cos(theta) + dy sin(theta)``,
    and multiplied by the linear scale. The travelled distance is the sum of these values. The heading is multiplied by
    the angular scale. Fractions of a count are kept, so that slow motion is not lost. Counting begins at the first
    pose. If the heading jumps by a full turn, because its range is limited to +-pi, the jump is removed.

    Args:
        linear_scale: Counts per m. The known robots and MRC use 100000, or a scale given by their wheels.
        angular_scale: Counts per rad. MRC always uses 40000.

    Attributes:
        transpos: Travelled distance in counts.
        rotpos: Heading in counts.

    Raises:
        BadValue: If a scale is zero or not a number.
    """

    def __init__(self, linear_scale: float = 1e5, angular_scale: float = 4e4) -> None:
        for name, scale in (("linear_scale", linear_scale), ("angular_scale", angular_scale)):
            if not math.isfinite(scale) or scale == 0.0:
                raise BadValue(f"{name}={scale} is not a scale; expected a finite number other than 0")
        self._linear, self._angular = linear_scale, angular_scale
        self._last: tuple[float, float, float] | None = None
        self._travelled = 0.0
        self.transpos = 0
        self.rotpos = 0

    def update(self, x: float, y: float, theta: float) -> None:
        """Process the next pose, in m, m and rad.

        Raises:
            BadValue: If a number is not finite. Nothing is changed.
        """
        travelled, heading = self._travelled, theta
        if math.isfinite(x) and math.isfinite(y) and math.isfinite(theta) and self._last is not None:
            last_x, last_y, last_theta = self._last
            travelled += ((x - last_x) * math.cos(theta) + (y - last_y) * math.sin(theta)) * self._linear
            # Use the shorter turn, so that a heading kept within +-pi does not count a full turn at each wrap.
            heading = last_theta + math.remainder(theta - last_theta, 2 * math.pi)
        if not (math.isfinite(x + y + travelled) and math.isfinite(heading * self._angular)):
            raise BadValue(f"{x}, {y}, {theta} is not a pose that can be counted; expected finite numbers")
        self._last = (x, y, heading)
        self._travelled = travelled
        self.transpos = wrapped(travelled)
        self.rotpos = wrapped(heading * self._angular)


#: Forward velocity, in m/s, below which the robot does not move.
DEAD_BAND = 0.005
#: Largest plausible coordinate of a pose, in m or rad; maximum number of poses that wait for a tick.
_FARTHEST = 1e6
_MOST_POSES = 1000


class Twist(NamedTuple):
    """Velocity of a robot: forward speed in m/s, and turn rate to the left in rad/s."""

    linear: float
    angular: float


class VelocityBridge(Plugin):
    """Plugin that passes velocities to a function, and receives poses.

    The function is called when a program has written a velocity that differs from the previous velocity. It is called
    with zero when the last client that may write has disconnected. The function runs in a separate thread, so it may
    take long: the tick does not wait, and the next call gets the newest velocity. Exceptions of the function are logged
    and counted.

    Args:
        on_twist: Function that receives each new `Twist`.
        command_linear_scale: Scale of `cmdtransvel`, per m/s.
        command_angular_scale: Scale of `cmdrotvel`, per rad/s.
        linear_scale: Counts of `transpos` per m.
        angular_scale: Counts of `rotpos` per rad.
        dead_band: Forward velocity, in m/s, below which the velocity zero is passed.
        needs_master: Whether to pass the velocity zero when no client may write.
        own_thread: Whether to call the function in its own thread. With False it is called in the host's thread, for
            repeatable lockstep.

    Raises:
        BadValue: If a scale or the dead band is invalid.
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
                raise BadValue(f"the scale of a command is {scale}; expected a finite number other than 0")
        if not 0.0 <= dead_band < math.inf:
            raise BadValue(f"dead_band={dead_band}; expected 0 or more m/s")
        self._on_twist = on_twist
        self._scales = command_linear_scale, command_angular_scale
        self._odometer = Odometer(linear_scale, angular_scale)
        self._dead_band = dead_band
        self._needs_master = needs_master
        self._own_thread = own_thread
        self._queue = PacketQueue(latest)
        self._delivery: ThreadedDelivery | None = None
        self._poses: deque[tuple[float, float, float]] = deque(maxlen=_MOST_POSES)
        self._last = Twist(0.0, 0.0)  # the robot is at rest

    @property
    def stats(self) -> SubscriptionStatistics | None:
        """Counters of velocities; None before `init`, and without a separate thread."""
        return None if self._delivery is None else self._delivery.statistics

    def update_pose(self, x: float, y: float, theta: float) -> None:
        """Set the pose of the robot, in m, m and rad. Callable from any thread; programs receive it at the next tick.

        Raises:
            BadValue: If a number is not finite, or exceeds 1000 km or a million rad.
        """
        if not all(abs(value) <= _FARTHEST for value in (x, y, theta)):
            raise BadValue(f"{x}, {y}, {theta} is not a pose; expected numbers up to {_FARTHEST:g}")
        self._poses.append((float(x), float(y), float(theta)))

    def init(self, config: Element) -> None:
        """Start the thread that calls the function."""
        if self._own_thread:
            self._delivery = ThreadedDelivery(self._queue, self._on_twist, name=f"rhdlink {self.name}")

    def periodic(self, tick: int) -> None:
        """Pass on a new velocity, and set the variables from the received poses."""
        poses, odometer = self._poses, self._odometer
        if poses:
            # Process every pose in order, because the path between two poses counts, not only the last position. Stop
            # at the current number of poses, because another thread may add more.
            for _ in range(len(poses)):
                odometer.update(*poses.popleft())
            self.transpos, self.rotpos = odometer.transpos, odometer.rotpos
        # A master that is killed sends no zeros (docs/protocols/rhd.md, How MRC uses a host).
        if self._needs_master and not self.host.writers:
            self._hand_over(Twist(0.0, 0.0))
        elif self.is_updated(VelocityBridge.cmdtransvel) or self.is_updated(VelocityBridge.cmdrotvel):
            self._hand_over(self._commanded())

    def terminate(self) -> None:
        """Pass on the velocity zero, and wait until the function has received it."""
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

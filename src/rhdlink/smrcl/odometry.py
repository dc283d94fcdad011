"""Odometry: the position of the robot from its counters, computed step for step as MRC does.

A step adds the mean travel of both wheels along the heading that the robot has half-way through its turn. How far it
turned comes from the wheels, from a heading (`Odometry.heading`), or from a curvature. A step in which a counter moves
by `max_tick` or more is dropped as a fault, its turn with it.

A velocity-omega robot has one counter, taken for the left wheel, and the right one stands still: its metres per count
are doubled in the configuration, so that the mean is right again.
"""

from __future__ import annotations

import math

from .arithmetic import cosine, divide, normalize_angle, sine
from .planar_pose import PlanarPose
from .robot_conf import RobotConf

#: A difference beyond half of this is a counter of 30 bits that has wrapped.
_COUNTER = 1 << 30


class Odometry:
    """The state of the odometry.

    Args:
        conf: of the robot; what a script changes of it is changed here.

    Attributes:
        left_scale: m per count of the left counter.
        right_scale: likewise of the right one.
        width: between the wheels, m.
        period: of a cycle, s.
        max_tick: counts in one cycle from which on a step is a fault.
        heading_source: 0 for the wheels, 1 for `heading`, 2 for `curvature`.
        is_rate: `heading` is a rate in rad/s rather than an angle.
        is_relative: the counters tell the counts since the last cycle.
        pose: where the robot is since the start, or since it was set; the heading in [-pi, pi].
        heading: of a gyro or counter, rad.
        curvature: 1/m.
        velocity: m/s, as are `left_velocity` and `right_velocity`.
        distance: driven, m, forward and backward alike.
        left_distance, right_distance: m, backward counts off.
        left_step, right_step: counts in the last cycle.
        faults: steps that were dropped.
    """

    def __init__(self, conf: RobotConf) -> None:
        self.left_scale, self.right_scale = conf.left_scale, conf.right_scale
        self.width = conf.width
        self.period = conf.period
        self.max_tick = conf.max_tick
        self.heading_source = conf.heading_source
        self.is_rate = conf.is_rate
        self.is_relative = conf.is_relative
        self.pose = PlanarPose()
        self.heading = 0.0
        self.curvature = 0.0
        self.velocity = self.left_velocity = self.right_velocity = 0.0
        self.distance = self.left_distance = self.right_distance = 0.0
        self.left_step = self.right_step = 0
        self.faults = 0
        self._left = self._right = 0
        self._heading = 0.0

    def begin(self, left: int, right: int) -> None:
        """The counters, and `heading`, before the first step."""
        self._left, self._right = left, right
        self._heading = self.heading

    def update(self, left: int, right: int, cycles: int = 1) -> None:
        """One cycle, with the counters at its beginning.

        Args:
            left, right: the counters.
            cycles: periods since the last update; more than one where answers of the robot were missed.
        """
        most, seconds = self.max_tick * cycles, self.period * cycles
        self.right_step = steps_right = _step(right if self.is_relative else right - self._right)
        self.left_step = steps_left = _step(left if self.is_relative else left - self._left)
        self._left, self._right = left, right
        if not (abs(steps_right) < most and abs(steps_left) < most):
            self.faults += 1
            return
        way_right, way_left = steps_right * self.right_scale, steps_left * self.left_scale
        way = (way_right + way_left) / 2
        self.left_distance += way_left
        self.right_distance += way_right
        turn = self._turn(way, way_left, way_right, seconds)
        self.distance += abs(way)
        pose = self.pose
        half_way = pose.th + turn * 0.5
        pose.x += way * cosine(half_way)
        pose.y += way * sine(half_way)
        pose.th += turn
        if pose.th < -math.pi:
            pose.th += math.tau
        if pose.th > math.pi:
            pose.th -= math.tau
        self.velocity = way / seconds
        self.left_velocity = way_left / seconds
        self.right_velocity = way_right / seconds

    def _turn(self, way: float, way_left: float, way_right: float, seconds: float) -> float:
        if self.heading_source == 0:
            return divide(way_right - way_left, self.width)
        if self.heading_source == 1:
            if self.is_rate:
                turn = self.heading * seconds
                if self.left_step == 0 and self.right_step == 0:
                    self.heading = 0.0
                return turn
            turn = normalize_angle(self.heading - self._heading)
            self._heading = self.heading
            return turn
        return way * self.curvature if self.heading_source == 2 else 0.0


def _step(difference: int) -> int:
    """The difference of two counters of 32 bits, or of 30."""
    difference = (difference + 0x8000_0000) % 0x1_0000_0000 - 0x8000_0000
    if difference > _COUNTER // 2:
        return difference - _COUNTER
    return difference + _COUNTER if difference < -(_COUNTER // 2) else difference


class Covariance:
    """How far the odometry may be off: the covariance of heading, x and y since the last reset.

    First-order propagation of three sources: the scale of each wheel, whose variance grows with its travel, and the
    distance between the wheels, whose variance grows with the turn. Robots without two wheels get what follows from
    their one counter, as in MRC: it means little.

    Args:
        conf: of the robot; what a script changes of it later does not count here.

    Attributes:
        wheel: variance of a wheel's travel after 1 m, m2.
        base: relative variance of the distance between the wheels after a full turn.
        th_th, th_x, th_y, x_x, x_y, y_y: of the covariance matrix, rad2, rad m, m2.
    """

    def __init__(self, conf: RobotConf) -> None:
        self._conf = conf
        self.wheel = 1e-4
        self.base = 1e-2
        self.reset()

    def reset(self) -> None:
        """Nothing is uncertain, and the heading is that of the x axis."""
        self._th = 0.0
        self.th_th = self.th_x = self.th_y = self.x_x = self.x_y = self.y_y = 0.0

    def update(self, left_step: int, right_step: int) -> None:
        """One cycle, with the counts of both wheels in it."""
        if not (left_step or right_step):
            return
        left, right = left_step * self._conf.left_scale, right_step * self._conf.right_scale
        width = self._conf.width
        way, turn, curvature = (right + left) / 2, divide(right - left, width), divide(1.0, width)
        middle = self._th + turn / 2
        self._th += turn
        along_x, along_y = cosine(middle), sine(middle)
        # How the pose before moves the pose after: its heading turns the way.
        to_x, to_y = -way * along_y, way * along_x
        self.y_y += 2 * to_y * self.th_y + to_y * to_y * self.th_th
        self.x_y += to_y * self.th_x + to_x * self.th_y + to_x * to_y * self.th_th
        self.x_x += 2 * to_x * self.th_x + to_x * to_x * self.th_th
        self.th_y += to_y * self.th_th
        self.th_x += to_x * self.th_th
        # What is added: each source with its derivatives of heading, x and y. MRC counts the turn of the way by one
        # wheel twice; so it is here, or $odocov* would be others.
        base = divide(self.base * width * width, math.tau * abs(turn)) if turn else 0.0
        by_x, by_y = divide(to_x, width), divide(to_y, width)
        self._add(self.wheel * abs(right), curvature, along_x / 2 + by_x, along_y / 2 + by_y)
        self._add(self.wheel * abs(left), -curvature, along_x / 2 - by_x, along_y / 2 - by_y)
        self._add(base, -divide(turn, width), -divide(to_x * turn, width) / 2, -divide(to_y * turn, width) / 2)

    def _add(self, variance: float, th: float, x: float, y: float) -> None:
        self.th_th += variance * th * th
        self.th_x += variance * th * x
        self.th_y += variance * th * y
        self.x_x += variance * x * x
        self.x_y += variance * x * y
        self.y_y += variance * y * y

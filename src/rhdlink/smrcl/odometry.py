"""Odometry: the position of the robot from its counters, computed step by step as in MRC.

A step adds the mean travel of both wheels, along the heading half-way through the turn of the robot. The turn is
computed from the wheels, from a heading (`Odometry.heading`), or from a curvature. If a counter moves by `max_tick` or
more in one step, the step is dropped as a fault, together with its turn.

A velocity-omega robot has one counter, which is used as the left wheel. Its right wheel never moves. The configuration
doubles its metres per count, so that the mean of both wheels is right again.
"""

from __future__ import annotations

import math

from .arithmetic import cosine, divide, normalize_angle, sine
from .planar_pose import PlanarPose
from .robot_conf import RobotConf

#: Range of a counter of 30 bits. If a difference exceeds half of it, the counter has wrapped.
_COUNTER = 1 << 30


class Odometry:
    """State of the odometry.

    Args:
        conf: Initial configuration of the robot. A script changes the attributes below instead.

    Attributes:
        left_scale: m per count of the left counter.
        right_scale: m per count of the right counter.
        width: Distance between the wheels, in m.
        period: Duration of a cycle, in s.
        max_tick: Number of counts in one cycle that makes a step a fault.
        heading_source: 0 for the wheels, 1 for `heading`, 2 for `curvature`.
        is_rate: Whether `heading` is a rate in rad/s instead of an angle.
        is_relative: Whether the counters give the counts since the last cycle.
        pose: Pose of the robot since the start, or since it was set; the heading is in [-pi, pi].
        heading: Heading of a gyro or counter, in rad.
        curvature: Curvature of the path, in 1/m.
        velocity: Speed in m/s, like `left_velocity` and `right_velocity`.
        distance: Driven distance in m; driving backward increases it too.
        left_distance, right_distance: Travel of the wheels in m; driving backward decreases it.
        left_step, right_step: Counts in the last cycle.
        faults: Number of dropped steps.
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
        """Set the counters, and `heading`, before the first step."""
        self._left, self._right = left, right
        self._heading = self.heading

    def update(self, left: int, right: int, cycles: int = 1) -> None:
        """Perform one cycle, with the counters at its beginning.

        Args:
            left, right: Counters.
            cycles: Number of periods since the last update; more than 1 if answers of the robot were missed.
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
    """Return the difference of two counters of 32 or 30 bits."""
    difference = (difference + 0x8000_0000) % 0x1_0000_0000 - 0x8000_0000
    if difference > _COUNTER // 2:
        return difference - _COUNTER
    return difference + _COUNTER if difference < -(_COUNTER // 2) else difference


class Covariance:
    """Uncertainty of the odometry: the covariance of heading, x and y since the last reset.

    The covariance is propagated to first order from three sources. Two are the scales of the wheels; their variance
    grows with the travel. The third is the distance between the wheels; its variance grows with the turn. For robots
    without two wheels, the covariance follows from their one counter, as in MRC, and has little meaning.

    Args:
        conf: Configuration of the robot. Later changes by a script have no effect here.

    Attributes:
        wheel: Variance of a wheel's travel after 1 m, in m2.
        base: Relative variance of the distance between the wheels after a full turn.
        th_th, th_x, th_y, x_x, x_y, y_y: Elements of the covariance matrix, in rad2, rad m and m2.
    """

    def __init__(self, conf: RobotConf) -> None:
        self._conf = conf
        self.wheel = 1e-4
        self.base = 1e-2
        self.reset()

    def reset(self) -> None:
        """Set the covariance to zero, and the heading to the x axis."""
        self._th = 0.0
        self.th_th = self.th_x = self.th_y = self.x_x = self.x_y = self.y_y = 0.0

    def update(self, left_step: int, right_step: int) -> None:
        """Perform one cycle, with the counts of both wheels in it."""
        if not (left_step or right_step):
            return
        left, right = left_step * self._conf.left_scale, right_step * self._conf.right_scale
        width = self._conf.width
        way, turn, curvature = (right + left) / 2, divide(right - left, width), divide(1.0, width)
        middle = self._th + turn / 2
        self._th += turn
        along_x, along_y = cosine(middle), sine(middle)
        # Effect of the previous pose on the new one: a heading error turns the driven distance.
        to_x, to_y = -way * along_y, way * along_x
        self.y_y += 2 * to_y * self.th_y + to_y * to_y * self.th_th
        self.x_y += to_y * self.th_x + to_x * self.th_y + to_x * to_y * self.th_th
        self.x_x += 2 * to_x * self.th_x + to_x * to_x * self.th_th
        self.th_y += to_y * self.th_th
        self.th_x += to_x * self.th_th
        # Add each source with its derivatives for heading, x and y. MRC counts the turn of the distance by one wheel
        # twice. This code does the same, because otherwise $odocov* would differ from MRC.
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

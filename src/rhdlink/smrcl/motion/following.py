"""Motions that follow a line or a wall: `followline`, `followwall` and `followwall2`."""

from __future__ import annotations

import math

from ..arithmetic import cosine, divide, normalize_angle, sine
from ..planar_pose import PlanarPose
from .control import ControlledMotion, MotionControl, limited


class FollowLine(ControlledMotion):
    """`followline`: steer towards the line.

    Without a line, continue and stop after `no_line_distance`.
    """

    #: Largest difference of a wheel speed from the speed of the robot, in m/s.
    LIMIT = 0.15

    def __init__(self) -> None:
        self._seen = PlanarPose()
        self._steering = 0.0

    def begin(self, control: MotionControl) -> None:
        """Start from the current speed."""
        self._seen = control.pose.copy()
        control.target = control.pose.copy()
        control.reached = control.velocity

    def update(self, control: MotionControl) -> None:
        """Steer according to the position of the line, damped by the turn since the last cycle."""
        parameters, pose = control.parameters, control.pose
        turned = pose.th - control.target.th
        control.target = pose.copy()
        control.ramp()
        steering = self._steering
        if not control.line_is_missing:
            self._seen = pose.copy()
            steering = parameters.line_gain * control.line_position() - parameters.line_tau * turned
        elif math.dist((pose.x, pose.y), (self._seen.x, self._seen.y)) > parameters.no_line_distance:
            control.reached = steering = 0.0
        self._steering = steering = limited(steering, -self.LIMIT, self.LIMIT)
        control.set_wheels(control.reached - steering, control.reached + steering)


class FollowWall(ControlledMotion):
    """`followwall`: keep a distance to a wall.

    A PD controller turns the target heading.

    Args:
        is_left: Whether the wall is on the left.
        distance: Distance to the wall, in m.
    """

    #: Limit of the steering, in m/s. Each wheel differs from the speed of the robot by at most half of it.
    LIMIT = 0.2

    def __init__(self, is_left: bool, distance: float) -> None:
        self._is_left = is_left
        self._distance = distance
        self._gain = self._state = self._proportional = self._feedback = 0.0

    def begin(self, control: MotionControl) -> None:
        """Set up the controller, a lead filter that is discretised with the bilinear transform."""
        parameters = control.parameters
        lag = 2 * parameters.wall_alfa * parameters.wall_tau + parameters.period
        self._proportional = divide(2 * parameters.wall_tau + parameters.period, lag)
        self._feedback = divide(2 * parameters.period, lag)
        # A `setpar` of the gain affects the next motion, but not this one.
        self._gain = parameters.wall_gain
        self._state = self._gain * self._error(control)
        control.target = control.pose.copy()
        control.reached = control.velocity

    def _error(self, control: MotionControl) -> float:
        """Return the error of the distance in m; it is positive if the robot must turn left."""
        return control.ir_left - self._distance if self._is_left else self._distance - control.ir_right

    def update(self, control: MotionControl) -> None:
        """Turn the target heading by the output of the controller, and steer to it."""
        parameters, pose, target = control.parameters, control.pose, control.target
        target.x, target.y = pose.x, pose.y
        control.ramp()
        error = self._error(control)
        if parameters.wall_input_mode == 1:
            if self._is_left:
                error += (control.wall_angle_left - math.pi / 2) * parameters.wall_angle_gain
            else:
                error -= (control.wall_angle_right + math.pi / 2) * parameters.wall_angle_gain
        scaled = self._gain * error
        rate = (scaled - self._state) * self._proportional + self._state
        self._state = (scaled - self._state) * self._feedback + self._state
        target.th += rate * parameters.period
        steering = limited(2 * normalize_angle(target.th - pose.th), -self.LIMIT, self.LIMIT)
        control.set_wheels(control.reached - steering / 2, control.reached + steering / 2)


class FollowWallTable(ControlledMotion):
    """`followwall2`: keep a distance to a wall along the x axis.

    State feedback takes its gains from a table.

    Args:
        is_left: Whether the wall is on the left.
        distance: Distance to the wall, in m.
    """

    #: Speed step from row to row of the table, in m/s; then the distances in m from the middle of the robot to its side
    #: sensors.
    SPEED_STEP = 0.01039
    SIDE, AHEAD = 0.13, 0.21

    def __init__(self, is_left: bool, distance: float) -> None:
        self._is_left = is_left
        self._distance = distance

    def begin(self, control: MotionControl) -> None:
        """Start from the current speed."""
        control.reached = control.velocity

    def update(self, control: MotionControl) -> None:
        """Steer according to the distance and the heading. Only ever speed up one wheel."""
        parameters, pose = control.parameters, control.pose
        c, s = cosine(pose.th), sine(pose.th)
        if self._is_left:
            there = abs(self.AHEAD * s + (self.SIDE + control.ir_left) * c)
        else:
            there = abs(self.AHEAD * s - (self.SIDE + control.ir_right) * c)
        if control.reached < control.speed:
            control.reached += parameters.period * control.acceleration
        row = math.floor(abs(control.reached) / self.SPEED_STEP + 0.5) - 1
        table = parameters.wall_table
        angle_gain, distance_gain, reference_gain = table[min(max(row, 0), len(table) - 1)]
        wanted = (self._distance + self.SIDE) * reference_gain
        if self._is_left:
            rate = -wanted - (-there * distance_gain + pose.th * angle_gain)
        else:
            rate = wanted - (there * distance_gain + pose.th * angle_gain)
        faster = abs(rate) * parameters.width / 2.0
        left, right = (0.0, faster) if rate >= 0 else (faster, 0.0)
        control.target = pose.copy()
        control.set_wheels(control.reached + left, control.reached + right)

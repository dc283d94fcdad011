"""`turn`, `turnr` and `turnc`: turn on the spot, along an arc, and along an arc of clothoids."""

from __future__ import annotations

import math

from ..arithmetic import NAN, cosine, divide, normalize_angle, power, sign, sine
from .control import ControlledMotion, DriveKind, MotionControl, limited, ramped, root

#: Radius in m below which the turn rate of a velocity-omega robot no longer grows.
_LEAST_RADIUS = 0.1
#: Half the distance between the wheels, in m, for which MRC's clothoids were made, and their period, in s.
_HALF_WIDTH = 0.13
_CLOTHOID_PERIOD = 0.01
#: Acceleration of a wheel in m/s2 above which MRC warns about a clothoid.
_SHARPEST = 1.0
#: Steering gain of `turnc`: rad/s for 1 rad.
_CLOTHOID_GAIN = 3.0


class Turn(ControlledMotion):
    """`turn`: turn on the spot, relative to the target heading, so that errors do not add up.

    Args:
        angle: Angle in rad; positive to the left.
    """

    #: Angle before the end at which the line ends, in rad.
    TOLERANCE = 0.01

    def __init__(self, angle: float) -> None:
        self._angle = angle
        self._turned = self._heading = 0.0

    def begin(self, control: MotionControl) -> None:
        """Turn the target."""
        control.reached = (abs(control.left_velocity) + abs(control.right_velocity)) / 2
        control.before = control.target.copy()
        if not control.profile.full_turns:
            self._angle = normalize_angle(self._angle)
        self._heading = control.pose.th
        self._turned = normalize_angle(control.pose.th - control.before.th)
        control.target.th = normalize_angle(control.target.th + normalize_angle(self._angle))

    def update(self, control: MotionControl) -> None:
        """Ramp up, and slow down before the end."""
        parameters, profile, acceleration = control.parameters, control.profile, control.acceleration
        wanted = abs(control.speed) if profile.turn_ramps else control.speed
        step = acceleration * parameters.period
        if wanted - control.reached > step:
            wanted = control.reached + step
        if wanted - control.reached < -step:
            wanted = control.reached - step
        most = control.reached = wanted
        remaining = self._angle - self._so_far(control)
        # Wheel speed from which the turn can still brake.
        wheel = root(abs(remaining) * parameters.width * 2.0 * acceleration)
        if remaining < 0.0:
            wheel = -wheel
        near = abs(remaining) * parameters.kp * parameters.width
        for bound in (most, near):
            wheel = limited(wheel, -bound, bound)
        if control.drive is DriveKind.VELOMEGA:
            control.left = control.right = 0.0
            control.omega = 2.0 * wheel / parameters.width
        else:
            control.left, control.right = -wheel, wheel
        if profile.full_turns:
            control.heading_error = remaining
        else:
            # The error is not normalised, so it jumps by a full turn when the heading wraps.
            control.heading_error = control.target.th - control.pose.th

    def _so_far(self, control: MotionControl) -> float:
        """Return the angle turned so far from the previous target heading, in rad."""
        heading = control.pose.th
        if control.profile.full_turns:
            self._turned += normalize_angle(heading - self._heading)
            self._heading = heading
            return self._turned
        turned = normalize_angle(heading - control.before.th)
        if self._angle > math.pi / 2 and turned < -math.pi / 2:
            turned += math.tau
        elif self._angle < -math.pi / 2 and turned > math.pi / 2:
            turned -= math.tau
        return turned

    def is_done(self, control: MotionControl) -> bool:
        """Whether the heading is within 0.01 rad of the end."""
        return abs(control.heading_error) < self.TOLERANCE

    def progress(self, control: MotionControl) -> float:
        """Finished part, from the remaining angle."""
        return 1.0 - abs(control.heading_error / self._angle) if self._angle else 1.0


class ArcTurn(ControlledMotion):
    """`turnr`: drive along a circle until the robot has turned by the angle.

    The centre is beside the target.

    Args:
        radius: Radius in m.
        angle: Angle in rad. The centre is on the left if it is positive. Driving backward turns the heading the other
            way.
        is_piece: Whether it is a piece of `drivetopoint`, which continues after it.
    """

    def __init__(self, radius: float, angle: float, *, is_piece: bool = False) -> None:
        self._radius = radius
        self._angle = angle
        self._is_piece = is_piece
        self._centre = 0.0, 0.0
        self._heading = self._turned = 0.0
        self._left = self._right = 0.0

    def begin(self, control: MotionControl) -> None:
        """Find the centre, and turn the target."""
        self._left = self._right = control.reached = control.velocity
        target = control.target
        control.before = target.copy()
        self._heading = control.pose.th
        self._turned = 0.0
        side = sign(self._angle)
        self._centre = (
            target.x - self._radius * sine(target.th) * side,
            target.y + self._radius * cosine(target.th) * side,
        )
        target.th = normalize_angle(target.th + sign(control.speed) * self._angle)

    def update(self, control: MotionControl) -> None:
        """Ramp up, and keep the heading along the tangent at the position of the robot."""
        pose = control.pose
        control.target.x, control.target.y = pose.x, pose.y
        self._turned += normalize_angle(pose.th - self._heading)
        self._heading = pose.th
        control.ramp()
        is_over = self._is_over(control)
        side = sign(self._angle)
        tangent = math.atan2(pose.y - self._centre[1], pose.x - self._centre[0]) + side * math.pi / 2
        steering = control.heading_control(tangent - pose.th)
        # Ramp the wheel speeds of a velocity-omega robot as well, for the next motion.
        left, right = self._wheels(control, side)
        if control.drive is DriveKind.VELOMEGA:
            control.left = control.right = control.reached
            control.omega = steering + side * control.reached / max(self._radius, _LEAST_RADIUS)
        else:
            if is_over:
                left = right = control.speed
            self._left, self._right = left, right
            control.left, control.right = left - steering, right + steering
        control.remaining = 0.0 if is_over else 1.0
        if is_over and control.profile.turnr_ends and not self._is_piece:
            control.finish()

    def _is_over(self, control: MotionControl) -> bool:
        turned = abs(self._turned)
        if self._is_piece and control.profile.topoint_is_signed:
            # While the robot still rolls in the other direction, it turns to the other side.
            turned = self._turned * sign(self._angle) * sign(control.speed)
        return abs(self._angle) - turned < 0.0

    def _wheels(self, control: MotionControl, side: float) -> tuple[float, float]:
        half = control.parameters.width / 2
        rate = (
            abs(control.reached / self._radius)
            if self._radius > half
            else abs(2 * control.reached / control.parameters.width)
        )
        rate *= sign(control.speed)
        step = control.acceleration * control.parameters.period
        left = ramped(rate * (self._radius - side * half), self._left, step)
        right = ramped(rate * (self._radius + side * half), self._right, step)
        return left, right

    def is_done(self, control: MotionControl) -> bool:
        """Whether the robot has turned far enough."""
        return abs(control.remaining) < 0.005

    def progress(self, control: MotionControl) -> float:
        """Finished part, from the angle turned so far."""
        return abs(self._turned / self._angle) if self._angle else 1.0


class Clothoid(ControlledMotion):
    """`turnc`: drive an arc whose curvature grows up to its middle and then shrinks.

    The driven distance ends the motion.

    The path is a pair of clothoids with the same angle. It joins the two tangents that a circle of the radius would
    touch.

    Args:
        radius: Radius in m.
        angle: Angle in rad.
    """

    def __init__(self, radius: float, angle: float) -> None:
        self._radius = radius
        self._angle = angle
        self._heading = self._turned = 0.0
        self._driven = self._half = self._sharpness = 0.0
        self._left = self._right = 0.0
        self._left_wanted = self._right_wanted = 0.0

    def begin(self, control: MotionControl) -> None:
        """Find the sharpness of the clothoids, and turn the target."""
        self._left = self._right = control.reached = control.velocity
        control.before = control.target.copy()
        self._heading = control.pose.th
        control.target.th = normalize_angle(control.target.th + self._angle)
        self._left_wanted = self._right_wanted = control.speed
        angle, radius = abs(self._angle), self._radius
        c, s = cosine(angle - math.pi / 2), sine(angle - math.pi / 2)
        # Length of the tangents from their intersection.
        tangent = divide(power(radius * c, 2.0) + power(radius * s + radius, 2.0), 2 * radius * c)
        across, along = _fresnel(math.sqrt(angle / math.pi))
        # Curvature per metre of the path, in 1/m2.
        opened = across + along * (math.tan(angle / 2) if angle < math.inf else NAN)
        self._sharpness = power(divide(1.0, tangent), 2.0) * math.pi * power(opened, 2.0)
        self._half = root(divide(angle, self._sharpness))
        if self._angle > math.pi / 2:
            control.report("Warning angles larger than 90 degrees are not recomended")
        if self._sharpness * control.speed > _SHARPEST / _HALF_WIDTH:
            control.report("Warning to sharp turn")

    def update(self, control: MotionControl) -> None:
        """Set the wheel speeds, and steer to the planned heading.

        The speeds move apart up to the middle, and together after it.
        """
        pose, target = control.pose, control.target
        self._driven += root(power(pose.x - target.x, 2.0) + power(pose.y - target.y, 2.0))
        target.x, target.y = pose.x, pose.y
        self._turned += normalize_angle(pose.th - self._heading)
        self._heading = pose.th
        side = sign(self._angle)
        step = control.acceleration * control.parameters.period
        opening = self._sharpness * power(control.reached, 2.0) * (2 * _HALF_WIDTH) / 2 * _CLOTHOID_PERIOD
        if self._driven < self._half:
            planned = side * 0.5 * self._sharpness * power(self._driven, 2.0)
        else:
            opening = -opening
            left_over = self._driven - 2 * self._half
            planned = side * (-0.5 * self._sharpness * power(left_over, 2.0)) + self._angle
        self._right_wanted += side * opening
        self._left_wanted += -side * opening
        control.ramp()
        slower = divide(control.reached, control.speed)
        right = ramped(self._right_wanted * slower, self._right, step)
        left = ramped(self._left_wanted * slower, self._left, step)
        is_over = self._driven > 2 * self._half
        if is_over:
            left = right = control.speed
        control.remaining = 0.0 if is_over else 1.0
        self._left, self._right = left, right
        limit = control.parameters.limit
        steering = limited(_CLOTHOID_GAIN * normalize_angle(planned - self._turned), -limit, limit)
        control.set_wheels(left - steering, right + steering)
        if is_over and control.profile.turnr_ends:
            control.finish()

    def is_done(self, control: MotionControl) -> bool:
        """Whether the robot has driven the whole path."""
        return abs(control.remaining) < 0.005

    def progress(self, control: MotionControl) -> float:
        """Finished part, from the driven distance."""
        return self._driven / (2 * self._half) if self._half > 0.0 else 1.0


def _fresnel(x: float) -> tuple[float, float]:
    """Return the Fresnel integrals C(x) and S(x), of cos and sin of ``pi/2 t**2``, from their power series.

    Here `x` is at most 5, and a turn of pi has 1. The series converge to the last digit for `x` up to about 3.
    """
    z = math.pi / 2 * x * x
    across = along = 0.0
    term = x
    for number in range(0, 200, 2):
        across += term / (2 * number + 1)
        term *= z / (number + 1)
        along += term / (2 * number + 3)
        term *= -z / (number + 2)
        if abs(term) < 1e-18 * abs(x):
            break
    return across, along

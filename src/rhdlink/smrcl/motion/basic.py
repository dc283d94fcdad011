"""Motions without a goal pose, and test signals.

The commands are `fwd`, `drive`, `motorcmds`, `stop`, `align` and `funcgen`.

The motion of `idle` is in `control`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from ..arithmetic import cosine, divide, normalize_angle, sign, sine, truncate
from .control import ControlledMotion, DriveKind, MotionControl, limited, ramped, root


class Stop(ControlledMotion):
    """`stop`: hold the heading of the target."""

    def update(self, control: MotionControl) -> None:
        """Turn back by the heading error."""
        error = normalize_angle(control.target.th - control.pose.th)
        steering = control.parameters.gain * error
        if control.drive is DriveKind.VELOMEGA and control.profile.stop_stands:
            limit = control.parameters.limit
            control.left = control.right = 0.0
            control.omega = limited(steering, -limit, limit)
        else:
            # A velocity-omega robot takes the speed of the left wheel as its own speed.
            control.left, control.right = -steering, steering

    def is_done(self, control: MotionControl) -> bool:
        """Return True: the motion is done immediately."""
        return True


class Align(ControlledMotion):
    """`align`: press the robot against an obstacle.

    A stopped wheel gets 4 m/s, which its motor limits.
    """

    #: Speed in m/s below which a wheel counts as stopped, and the speed that it then gets.
    STOPPED = 0.01
    PRESSING = 4.0

    def update(self, control: MotionControl) -> None:
        """Drive both wheels."""
        control.target = control.pose.copy()
        control.set_wheels(
            self.PRESSING if abs(control.left_velocity) < self.STOPPED else control.speed,
            self.PRESSING if abs(control.right_velocity) < self.STOPPED else control.speed,
        )


class FunctionGenerator(ControlledMotion):
    """`funcgen`: generate a signal for the robot's variable in `routeoutput`.

    The speeds do not change.

    Args:
        parameters: Kind of signal, and its numbers. 0 is a step (height, s until it begins, s that it lasts). 1 is a
            square wave and 2 a sine (amplitude, Hz, s). 3 is a sweep (rate of change, Hz at the beginning and at the
            end in rad/s, s).

    Attributes:
        output: Current value of the signal.
    """

    _PERIOD = 0.01

    def __init__(self, parameters: Sequence[float]) -> None:
        self._parameters = tuple(parameters)
        self.output = 0.0
        self._is_over = False

    def update(self, control: MotionControl) -> None:
        """Compute the next value."""
        kind, first, second, third, fourth = self._parameters
        number, cycles, period = truncate(kind), control.cycles, self._PERIOD
        if number == 0:
            begin = second / period
            end = third / period + begin
            self._is_over = cycles > end
            if not self._is_over:
                self.output = first if begin <= cycles < end else 0.0
        elif number in (1, 2, 3):
            self._is_over = cycles >= (fourth if number == 3 else third) / period
            if self._is_over:
                return
            if number == 1:
                half = divide(1.0, second) * 0.5
                halves = divide(cycles * period, half) - 0.5
                # As `round` in C: halves are rounded away from zero.
                is_odd = math.isfinite(halves) and math.floor(abs(halves) + 0.5) % 2 == 1
                self.output = first if is_odd else -first
            elif number == 2:
                self.output = first * sine(divide(math.tau * (cycles * period), divide(1.0, second)))
            else:
                squared = cycles * period * cycles * period
                self.output = sine(second * cycles * period + (third - second) / 2 * first * squared)

    def is_done(self, control: MotionControl) -> bool:
        """Whether the signal has ended."""
        return self._is_over


class Forward(ControlledMotion):
    """`fwd`: drive straight to a target that is moved forward along its heading.

    The distance is added to the target instead of the pose, so that errors do not add up. The robot slows down near the
    end. The line ends 5 mm before the target, and the robot continues to the target unless another motion begins.
    """

    #: Distance before the target at which the line ends, in m.
    TOLERANCE = 0.005

    def __init__(self, distance: float) -> None:
        self._distance = distance

    def begin(self, control: MotionControl) -> None:
        """Move the target forward."""
        control.distance = self._distance
        control.reached = abs(control.velocity)
        target = control.target
        control.before = target.copy()
        target.x += self._distance * cosine(target.th)
        target.y += self._distance * sine(target.th)

    def update(self, control: MotionControl) -> None:
        """Ramp up, slow down before the target or an obstacle, and steer to the heading."""
        parameters, pose, target = control.parameters, control.pose, control.target
        acceleration = control.acceleration
        velocity = ramped(abs(control.speed), control.reached, acceleration * parameters.period)
        remaining = (target.x - pose.x) * cosine(target.th) + (target.y - pose.y) * sine(target.th)
        is_ahead = control.distance > 0.0
        free = control.clearance(is_ahead)
        if abs(remaining) > free and not control.ignores_obstacles:
            way, direction = free, 1.0 if is_ahead else -1.0
        else:
            way, direction = abs(remaining), sign(remaining)
        velocity = min(velocity, root(2.0 * way * acceleration), parameters.kp * way)
        control.reached = velocity
        control.set_velocity(velocity * direction, control.heading_control(control.before.th - pose.th))
        control.remaining = remaining

    def is_done(self, control: MotionControl) -> bool:
        """Whether the robot is 5 mm before the target, or beyond it."""
        return sign(control.distance) * control.remaining < self.TOLERANCE

    def progress(self, control: MotionControl) -> float:
        """Finished part, from the remaining distance."""
        return 1.0 - control.remaining / self._distance if self._distance else 1.0


class FollowDirection(ControlledMotion):
    """`drive` and its variants: drive along the line through the reference.

    The motion has no end. Its direction is the direction of the reference.

    Args:
        keeps_speed: Whether to begin at the commanded speed (`driveon`) instead of the robot's speed.
        is_world: Whether the reference is in world coordinates (`drivew`, `driveonw`).
    """

    def __init__(self, *, keeps_speed: bool = False, is_world: bool = False) -> None:
        self._keeps_speed = keeps_speed
        self._is_world = is_world

    def begin(self, control: MotionControl) -> None:
        """Set the speed to start from."""
        control.reached = control.speed if self._keeps_speed else control.velocity

    def update(self, control: MotionControl) -> None:
        """Steer according to the distance to the line and the angle to its direction."""
        parameters, pose, reference = control.parameters, control.pose, control.reference
        control.target = pose.copy()
        control.ramp()
        x, y, th = reference.x, reference.y, reference.th
        if self._is_world:
            world = control.world
            c, s = cosine(world.th), sine(world.th)
            x, y = c * x - s * y + world.x, s * x + c * y + world.y
            th = normalize_angle(th + world.th)
        c, s = cosine(th), sine(th)
        control.remaining = (x - pose.x) * c + (y - pose.y) * s
        error = normalize_angle(th - pose.th)
        # The line in normal form: the distance to it is positive on the left.
        offset = (pose.x * -s + pose.y * c + -(-s * x + c * y)) + control.distance
        if parameters.drive_kdist > 0.0:
            # At this distance from the line or more, the robot drives straight towards the line.
            most = abs(parameters.drive_kangle * math.pi / 2 / parameters.drive_kdist)
            if abs(offset) > most:
                offset = most * sign(offset)
        offset *= sign(control.reached)
        rate = -parameters.drive_kdist * offset + parameters.drive_kangle * error
        if control.drive is DriveKind.DIFFERENTIAL:
            rate *= parameters.width
        # The limit is the same for a turn rate and for a wheel speed, so a velocity-omega robot turns much slower here.
        control.set_velocity(control.reached, limited(rate, -parameters.limit, parameters.limit))


class Wheels(ControlledMotion):
    """`motorcmds`: set the given speeds of the wheels."""

    def __init__(self, left: float, right: float) -> None:
        self._left, self._right = left, right

    def update(self, control: MotionControl) -> None:
        """Set the speeds."""
        control.target = control.pose.copy()
        control.set_wheels(self._left, self._right)

    def is_done(self, control: MotionControl) -> bool:
        """Return True: the motion is done immediately."""
        return True

"""Motion control: the state that all motions share, and its cycle.

In each cycle, a motion computes the wheel speeds from the pose, the speed and the sensors. For a velocity-omega robot,
it computes a speed and a turn rate. MRC keeps one large structure that its motions read and write. Values that one
motion leaves in this structure affect the next motion; examples are the target pose after an interrupted `fwd`, and the
turn rate after `stop`. This module does the same: a motion is an object, but targets, speeds and outputs belong to
`MotionControl`.
"""

from __future__ import annotations

import enum
import math
from collections.abc import Callable
from dataclasses import dataclass, field

from ..arithmetic import NAN, normalize_angle, sign
from ..planar_pose import PlanarPose
from ..profile import Profile


class DriveKind(enum.Enum):
    """Kind of drive of a robot."""

    DIFFERENTIAL = "differential"
    VELOMEGA = "velomega"


@dataclass
class MotionParameters:
    """Settings of motion control, from `robot.conf` and `setpar`.

    The defaults are those of MRC without a configuration file.

    Attributes:
        period: Duration of a cycle, in s.
        width: Distance between the wheels, in m.
        kp: Gain of the remaining distance, in 1/s. It limits the speed near the end of `fwd` and `turn`.
        gain: Gain of the heading error, in m/s (of a wheel) or rad/s, for 1 rad.
        limit: Largest part of a wheel speed (m/s) or of the turn rate (rad/s) that the heading error can add.
        stop_distance: Distance to an obstacle at which the robot stops, in m.
        alarm_distance: Distance before the stop distance at which the motion status reports an obstacle, in m.
        drive_kdist, drive_kangle: Gains of `drive`, in rad/s for 1 m and for 1 rad.
        line_gain, line_tau: Gains of `followline`, in m/s for 1 cm, and for 1 rad of heading since the last cycle.
        no_line_distance: Distance that `followline` drives without a line, in m.
        wall_gain, wall_tau, wall_alfa: Settings of the PD controller of `followwall`, in rad/s for 1 m.
        wall_angle_gain, wall_input_mode: m for 1 rad of the angle to the wall; used if the mode is 1.
        wall_table: Gains of `followwall2` for angle, distance and reference, for each 0.01039 m/s of speed.
        evaluation: Choice of `drivetopoint`: 0 is the shortest path, 1 the shortest path without driving backward.
    """

    period: float = 0.01
    width: float = 0.26
    kp: float = 10.0
    gain: float = 1.0
    limit: float = 0.2
    stop_distance: float = 0.18
    alarm_distance: float = 0.1
    drive_kdist: float = 0.0
    drive_kangle: float = 0.0
    line_gain: float = 0.05
    line_tau: float = 20.0
    no_line_distance: float = 0.2
    wall_gain: float = 1.0
    wall_tau: float = 7.0
    wall_alfa: float = 0.2
    wall_angle_gain: float = 1.0
    wall_input_mode: float = 0.0
    wall_table: tuple[tuple[float, float, float], ...] = ()
    evaluation: float = 0.0


class ControlledMotion:
    """Motion of a robot.

    `begin` is called in the cycle that executes its line, and `update` in that cycle and all later ones.
    """

    def begin(self, control: MotionControl) -> None:
        """Start from the state that the previous motion left."""

    def update(self, control: MotionControl) -> None:
        """Set the speeds for one cycle."""

    def is_done(self, control: MotionControl) -> bool:
        """Whether the line of the script has ended without a stop condition.

        It is False for motions that only a stop condition ends.
        """
        return False

    def progress(self, control: MotionControl) -> float:
        """Finished part of the motion, 0 to 1; 0 for a motion without an end."""
        return 0.0


class Standing(ControlledMotion):
    """Motors at zero: the motion of `idle`, and of a robot before its first command."""

    def update(self, control: MotionControl) -> None:
        """Set all speeds to zero."""
        control.left = control.right = control.omega = 0.0

    def is_done(self, control: MotionControl) -> bool:
        """Return True: the motion is done immediately."""
        return True


@dataclass
class MotionControl:
    """State that all motions share.

    Attributes:
        parameters: Gains and limits.
        drive: Kind of drive.
        profile: Profile of the mission, like MRC or sound.
        speed: Commanded speed in m/s, set by ``@v``.
        acceleration: Acceleration in m/s2, set by ``@a``.
        pose: Pose of the robot in this cycle.
        velocity: Speed of the robot, in m/s. `left_velocity` and `right_velocity` are the speeds of its wheels.
        obstacle_front, obstacle_back: Distance to the next obstacle, in m.
        ir_left, ir_right: Distances to the walls, in m.
        wall_angle_left, wall_angle_right: Angles of the walls to the robot, in rad, if a sensor measures them.
        line_position: Function that returns the position of the followed line, in cm to the left.
        line_is_missing: Whether no line is detected.
        reference: Point and direction that `drive` follows, in odometry or world coordinates.
        world: Pose of the world's origin in odometry coordinates, for `drivew`.
        distance: Distance of the last `fwd`, in m.
        target: Target pose of motions, which `fwd` and `turn` move.
        before: Target before the current motion.
        heading_error: Remaining angle of `turn`, in rad.
        remaining: Value of `$targetdist`: m to the target; for arcs 1 until the end, and then 0.
        is_blocked: Whether an obstacle is near: `$motionstatus`.
        ignores_obstacles: Whether the current motion does not slow down before obstacles.
        cycles: Number of cycles since the motion began.
        left, right: Wheel speeds in m/s; for a velocity-omega robot, both are its speed.
        omega: Turn rate of a velocity-omega robot, in rad/s.
        report: Function that receives the text that MRC prints about a motion.
        motion: Current motion.
        reached: Speed that the motion has reached, in m/s.
    """

    parameters: MotionParameters
    drive: DriveKind
    profile: Profile
    speed: float = 0.3
    acceleration: float = 0.6
    pose: PlanarPose = field(default_factory=PlanarPose)
    velocity: float = 0.0
    left_velocity: float = 0.0
    right_velocity: float = 0.0
    obstacle_front: float = 1.0
    obstacle_back: float = 1.0
    ir_left: float = 0.0
    ir_right: float = 0.0
    wall_angle_left: float = 0.0
    wall_angle_right: float = 0.0
    line_position: Callable[[], float] = float
    line_is_missing: bool = False
    reference: PlanarPose = field(default_factory=PlanarPose)
    world: PlanarPose = field(default_factory=PlanarPose)
    distance: float = 0.0
    target: PlanarPose = field(default_factory=PlanarPose)
    before: PlanarPose = field(default_factory=PlanarPose)
    heading_error: float = 0.0
    remaining: float = 0.0
    is_blocked: bool = False
    ignores_obstacles: bool = False
    cycles: int = 0
    left: float = 0.0
    right: float = 0.0
    omega: float = 0.0
    report: Callable[[str], object] = str
    motion: ControlledMotion = field(default_factory=Standing)
    reached: float = 0.0

    def __post_init__(self) -> None:
        self._next: ControlledMotion | None = None
        self._ignores_next = False
        self._finishing: int | None = None

    def start(self, motion: ControlledMotion) -> None:
        """Begin `motion` in this cycle. If there are several calls, the last one counts."""
        self._next = motion

    def ignore_obstacles(self) -> None:
        """Let the next motion ignore obstacles."""
        self._ignores_next = True

    def update(self) -> None:
        """Perform one cycle."""
        motion = self._next
        if motion is not None:
            self.motion, self._next = motion, None
            self.ignores_obstacles, self._ignores_next = self._ignores_next, False
            self._finishing = None
            self.cycles = 0
            motion.begin(self)
        self.is_blocked = False
        self.motion.update(self)
        if self._finishing is not None:
            # The script detects the end of a motion one cycle later, and its next line begins in the following cycle.
            self._finishing -= 1
            if self._finishing < 0:
                self.rest()
        self.cycles += 1

    def finish(self) -> None:
        """End the current motion: stop, unless another motion begins within the next two cycles."""
        if self._finishing is None:
            self._finishing = 2

    def rest(self) -> None:
        """Stop the motors, beginning with this cycle."""
        self.motion = Standing()
        self._finishing = None
        self.motion.update(self)

    # -- helpers for motions -----------------------------------------------------------------------

    def set_velocity(self, velocity: float, steering: float) -> None:
        """Set a speed in m/s, and the steering of a heading controller.

        The steering is in m/s for each wheel, or in rad/s of turn rate.
        """
        if self.drive is DriveKind.VELOMEGA:
            self.left = self.right = velocity
            self.omega = steering
        else:
            self.left = velocity - steering
            self.right = velocity + steering

    def set_wheels(self, left: float, right: float) -> None:
        """Set the wheel speeds in m/s, for motions that compute only wheel speeds."""
        self.left, self.right = left, right
        if self.drive is DriveKind.VELOMEGA and self.profile.velomega_steers:
            self.left = self.right = (left + right) / 2
            self.omega = (right - left) / self.parameters.width

    def heading_control(self, error: float) -> float:
        """Compute the steering for `set_velocity` from a heading error in rad."""
        limit = self.parameters.limit
        return limited(self.parameters.gain * normalize_angle(error), -limit, limit)

    def ramp(self) -> None:
        """Change `reached` towards the commanded speed, as far as obstacles allow."""
        velocity = ramped(self.speed, self.reached, self.acceleration * self.parameters.period)
        most = root(2.0 * self.clearance(velocity > 0.0) * self.acceleration) * sign(velocity)
        if abs(most) < abs(velocity) and not self.ignores_obstacles:
            velocity = most
        self.reached = velocity

    def clearance(self, is_ahead: bool) -> float:
        """Return the distance in m, ahead or behind, to the point where the robot must stop.

        Set `is_blocked` if this point is near.
        """
        free = (self.obstacle_front if is_ahead else self.obstacle_back) - self.parameters.stop_distance
        free = max(free, 0.0)
        if free < self.parameters.alarm_distance:
            self.is_blocked = True
        return free


def limited(value: float, least: float, most: float) -> float:
    """Limit `value` to two bounds; nan stays nan."""
    return max(min(value, most), least)


def ramped(wanted: float, now: float, step: float) -> float:
    """Return `wanted`; if it is more than `step` away from `now`, return `now` changed by `step` towards it."""
    if wanted > now + step:
        return now + step
    return now - step if wanted < now - step else wanted


def root(value: float) -> float:
    """Return the square root; nan for a negative value."""
    return math.sqrt(value) if value >= 0.0 else NAN

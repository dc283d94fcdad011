"""Motion control: the state that all motions share, and its cycle.

In each cycle a motion turns the pose, the speed and the sensors into the speeds of the wheels, or of a velocity-omega
robot into speed and turn rate. MRC keeps one large structure that its motions read and write; what one of them leaves
there changes the next (the target pose after an interrupted `fwd`, the turn rate after `stop`). So it is here: a motion
is an object, but targets, speeds and outputs belong to `MotionControl`.
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
    """How a robot is driven."""

    DIFFERENTIAL = "differential"
    VELOMEGA = "velomega"


@dataclass
class MotionParameters:
    """What `robot.conf` says of a robot's motion control, and `setpar` changes; the defaults are MRC's without a file.

    Attributes:
        period: of a cycle, s.
        width: between the wheels, m.
        kp: 1/s, of the remaining distance: bounds the speed near the end of `fwd` and `turn`.
        gain: of the heading error, m/s (of a wheel) or rad/s, for 1 rad.
        limit: of what the heading error adds to a wheel, m/s, or to the turn rate, rad/s.
        stop_distance: m at which the robot stands before an obstacle.
        alarm_distance: m before that, within which the motion status says that there is one.
        drive_kdist, drive_kangle: of `drive`: rad/s for 1 m, and for 1 rad.
        line_gain, line_tau: of `followline`: m/s for 1 cm, and for 1 rad of heading since the last cycle.
        no_line_distance: m that `followline` drives on without a line.
        wall_gain, wall_tau, wall_alfa: of `followwall`: its PD controller, rad/s for 1 m.
        wall_angle_gain, wall_input_mode: m for 1 rad of the angle to the wall, where the mode is 1.
        wall_table: for `followwall2`: angle gain, distance gain and reference gain for each 0.01039 m/s of speed.
        evaluation: how `drivetopoint` chooses: 0 the shortest path, 1 the shortest without driving backward.
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
    """One motion. `begin` is called in the cycle in which its line is executed, `update` from that cycle on."""

    def begin(self, control: MotionControl) -> None:
        """Take over from the motion before."""

    def update(self, control: MotionControl) -> None:
        """Set the speeds for one cycle."""

    def is_done(self, control: MotionControl) -> bool:
        """Whether the line of the script ends by itself: the default end. False for what only a condition ends."""
        return False

    def progress(self, control: MotionControl) -> float:
        """How much of it is behind the robot, 0 to 1; 0 for what has no end."""
        return 0.0


class Standing(ControlledMotion):
    """The motors at zero: `idle`, and what a robot does before its first command."""

    def update(self, control: MotionControl) -> None:
        """No speed."""
        control.left = control.right = control.omega = 0.0

    def is_done(self, control: MotionControl) -> bool:
        """At once."""
        return True


@dataclass
class MotionControl:
    """The state that all motions share.

    Attributes:
        parameters: gains and limits.
        drive: how the robot is driven.
        profile: as MRC does it, or sound.
        speed: m/s, set by ``@v``.
        acceleration: m/s2, set by ``@a``.
        pose: where the robot is, in this cycle.
        velocity: of the robot, m/s; `left_velocity` and `right_velocity` are its wheels'.
        obstacle_front, obstacle_back: m to the next obstacle.
        ir_left, ir_right: m to the walls.
        wall_angle_left, wall_angle_right: rad, of the walls to the robot, where something measures them.
        line_position: of the line to be followed, cm to the left; asked for when it is needed.
        line_is_missing: no line is seen.
        reference: what `drive` follows: a point and a direction, in odometry or world coordinates.
        world: the pose of the world's origin in odometry coordinates, for `drivew`.
        distance: of the last `fwd`, m.
        target: where motions aim at; what `fwd` and `turn` move on.
        before: the target before the present motion.
        heading_error: of `turn`'s end, rad.
        remaining: `$targetdist`: m to the target, or 0 and 1 for arcs.
        is_blocked: an obstacle is near: `$motionstatus`.
        ignores_obstacles: the present motion is not slowed down by them.
        cycles: since the motion began.
        left, right: m/s, the speeds of the wheels, or of a velocity-omega robot twice its speed.
        omega: rad/s, the turn rate of a velocity-omega robot.
        say: is given what MRC prints about a motion.
        motion: the one that is under way.
        reached: the speed that it has reached, m/s.
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
    say: Callable[[str], object] = str
    motion: ControlledMotion = field(default_factory=Standing)
    reached: float = 0.0

    def __post_init__(self) -> None:
        self._next: ControlledMotion | None = None
        self._ignores_next = False
        self._finishing: int | None = None

    def start(self, motion: ControlledMotion) -> None:
        """Begin `motion` in this cycle; of several the last counts."""
        self._next = motion

    def ignore_obstacles(self) -> None:
        """The next motion is not slowed down by obstacles."""
        self._ignores_next = True

    def update(self) -> None:
        """One cycle."""
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
            # The script sees the end of a motion one cycle late, and its next line begins in the one after that.
            self._finishing -= 1
            if self._finishing < 0:
                self.rest()
        self.cycles += 1

    def finish(self) -> None:
        """The present motion has come to its end: stand, unless another one begins within the next two cycles."""
        if self._finishing is None:
            self._finishing = 2

    def rest(self) -> None:
        """Stand from this cycle on."""
        self.motion = Standing()
        self._finishing = None
        self.motion.update(self)

    # -- what motions are made of ------------------------------------------------------------------

    def set_velocity(self, velocity: float, steering: float) -> None:
        """A speed, m/s, and what a heading controller adds: m/s for each wheel, or rad/s of turn rate."""
        if self.drive is DriveKind.VELOMEGA:
            self.left = self.right = velocity
            self.omega = steering
        else:
            self.left = velocity - steering
            self.right = velocity + steering

    def set_wheels(self, left: float, right: float) -> None:
        """The speeds of the wheels, m/s, by a motion that knows of nothing else."""
        self.left, self.right = left, right
        if self.drive is DriveKind.VELOMEGA and self.profile.velomega_steers:
            self.left = self.right = (left + right) / 2
            self.omega = (right - left) / self.parameters.width

    def heading_control(self, error: float) -> float:
        """What `set_velocity` takes as steering for a heading that is off by `error` rad."""
        limit = self.parameters.limit
        return limited(self.parameters.gain * normalize_angle(error), -limit, limit)

    def ramp(self) -> None:
        """Bring `reached` nearer to the speed that is commanded, as obstacles allow."""
        velocity = ramped(self.speed, self.reached, self.acceleration * self.parameters.period)
        most = root(2.0 * self.clearance(velocity > 0.0) * self.acceleration) * sign(velocity)
        if abs(most) < abs(velocity) and not self.ignores_obstacles:
            velocity = most
        self.reached = velocity

    def clearance(self, is_ahead: bool) -> float:
        """m to where the robot has to stand before an obstacle, ahead or behind; notes whether that is near."""
        free = (self.obstacle_front if is_ahead else self.obstacle_back) - self.parameters.stop_distance
        free = max(free, 0.0)
        if free < self.parameters.alarm_distance:
            self.is_blocked = True
        return free


def limited(value: float, least: float, most: float) -> float:
    """`value` between two bounds; nan stays nan."""
    return max(min(value, most), least)


def ramped(wanted: float, now: float, step: float) -> float:
    """`wanted`, or as far towards it from `now` as one `step` goes."""
    if wanted > now + step:
        return now + step
    return now - step if wanted < now - step else wanted


def root(value: float) -> float:
    """The square root; nan of what is negative."""
    return math.sqrt(value) if value >= 0.0 else NAN

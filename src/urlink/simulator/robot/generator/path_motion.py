"""Following a path from rest to rest: joint movements (movej), lines (movel, movep, servoc) and circles (movec).

A `MotionPath` gives the joints at a distance along it. A `Trapezoid` gives the distance over time: acceleration,
constant speed, braking, as the manual of the pendant draws it, as far as that is remembered. A `Blend` takes over the
speed of the movement before. How a controller blends is not published, so that is a guess.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from functools import cached_property

from urlink.arm.curves import Curve
from urlink.arm.parameters import number

from ..setpoint_sources import REST, Setpoint
from .joint_limits import ArmWithTool, LimitViolation

#: m that count as much as a turn of 1 rad, at least, so that a tool which turns in place takes its time. A guess.
RADIAN = number("metres_per_turn_simulated")

# Samples of a path of the tool for its largest speed, and rad from one to the next that are a jump through a
# singularity.
_SAMPLES, _JUMP = 64, 0.5


class Command(ABC):
    """A command that has begun.

    Attributes:
        is_over: whether the function that began it returns: the movement has ended, has come within its blend radius of
            the target, has lasted as long as requested, or was preempted.
        is_at_rest: whether the joints stand still, and will until the next command.
        overrun: s of scaled time by which the last cycle exceeded the time that was asked for.
    """

    is_over = is_at_rest = False
    overrun = 0.0

    @abstractmethod
    def advance(self, last: Setpoint, seconds: float, scaling: float, change: float) -> Setpoint:
        """The set-point one cycle after `last`, at a speed scaling that has changed by `change` over the cycle."""


# -- speed profiles ------------------------------------------------------------------------------------


class Trapezoid:
    """From rest to rest over a length, as fast as a speed and two accelerations allow: the speed over time is a
    trapezoid, or a triangle if the length is too short to reach the speed.

    Attributes:
        length: of the path, in the unit of the speed and the accelerations.
        duration: s.
        peak: the largest speed.
    """

    def __init__(self, length: float, speed: float, acceleration: float, rise: float | None = None) -> None:
        """`rise` is the acceleration while speeding up, if it differs from `acceleration` while slowing down."""
        rise = acceleration if rise is None else rise
        # Speeding up to v and slowing down from it take v² times this of the length.
        ramps = 0.5 / rise + 0.5 / acceleration
        peak = min(speed, math.sqrt(length / ramps))
        self.length, self.peak = length, peak
        self._rise, self._fall = rise, acceleration
        self._up = peak / rise
        cruise = max(length / peak - peak * ramps, 0.0) if peak > 0.0 else 0.0
        self._down = self._up + cruise
        self.duration = self._down + peak / acceleration

    def at(self, time: float) -> tuple[float, float, float]:
        """Distance, speed and acceleration, s after the start. From `duration` on it is at rest at the end."""
        if time >= self.duration:
            return self.length, 0.0, 0.0
        if time < self._up:
            return 0.5 * self._rise * time * time, self._rise * time, self._rise
        if time < self._down:
            return self.peak * (time - 0.5 * self._up), self.peak, 0.0
        left = self.duration - time
        return self.length - 0.5 * self._fall * left * left, self._fall * left, -self._fall


def timed(length: float, duration: float, speed: float, acceleration: float) -> tuple[float, float]:
    """The speed and the acceleration with which a length takes `duration` s, or the shortest possible time, by the
    largest `speed` and `acceleration`, if that is longer.

    A third of the time each for speeding up, constant speed and slowing down, where the limits allow that; a
    controller's own choice is not known.
    """
    even = 1.5 * length / duration, 4.5 * length / duration**2
    if even[0] <= speed and even[1] <= acceleration:
        return even
    # At the largest acceleration, length / v + v / acceleration = duration.
    root = (acceleration * duration) ** 2 - 4.0 * acceleration * length
    if root < 0.0:
        return speed, acceleration
    return min(0.5 * (acceleration * duration - math.sqrt(root)), speed), acceleration


# -- blends --------------------------------------------------------------------------------------------


class Blend:
    """The difference that is added to the set-points of a path while it takes over from another movement.

    A path begins at rest, at a position where the arm could come to rest. The blend begins with the difference to the
    present position and with the present speed, and ends with neither: six cubics of the time. So the sum of both leads
    from the old movement to the path with a continuous speed. If the distance is half the speed times the duration,
    the cubics are parabolas, which are constant decelerations.

    Attributes:
        duration: s.
    """

    def __init__(
        self, way: Sequence[float], qd: Sequence[float], duration: float, acceleration: Sequence[float]
    ) -> None:
        """Six joints with a distance of `way` rad and a speed of `qd` rad/s, in at least `duration` s.

        It takes longer if a joint would exceed its acceleration, rad/s².
        """

        def worst() -> float:
            return max(
                max(abs(6.0 * d / duration - 4.0 * v), abs(2.0 * v - 6.0 * d / duration)) / (duration * limit)
                for d, v, limit in zip(way, qd, acceleration, strict=True)
            )

        while worst() > 1.0 + 1e-9:
            duration *= 1.25
        self.duration = duration
        self._time = 0.0
        # In u = time / duration: q = -way + speed u + c u² + e u³, which is at rest at nothing where u is 1.
        self._cubics = [
            (-d, v * duration, 3.0 * d - 2.0 * v * duration, v * duration - 2.0 * d)
            for d, v in zip(way, qd, strict=True)
        ]

    @property
    def is_over(self) -> bool:
        """Whether it has ended, so that it adds nothing."""
        return self._time >= self.duration

    def advance(self, seconds: float) -> tuple[list[float], list[float], list[float]]:
        """What to add to positions, speeds and accelerations `seconds` later."""
        self._time += seconds
        if self.is_over:
            return REST, REST, REST
        t = self.duration
        u = self._time / t
        return (
            [a + u * (b + u * (c + u * e)) for a, b, c, e in self._cubics],
            [(b + u * (2.0 * c + 3.0 * u * e)) / t for _, b, c, e in self._cubics],
            [(2.0 * c + 6.0 * u * e) / (t * t) for _, _, c, e in self._cubics],
        )


# -- paths and their motion ----------------------------------------------------------------------------


class MotionPath(ABC):
    """The joints by the distance along a path.

    Attributes:
        length: of the path: rad of the joint that moves furthest, or m of the tool.
    """

    length: float

    def __init__(self, arm: ArmWithTool) -> None:
        self._arm = arm

    @property
    @abstractmethod
    def end_pose(self) -> list[float]:
        """The pose of the TCP at the end, m and rad."""

    @abstractmethod
    def fastest(self) -> tuple[float, float]:
        """The largest speed and acceleration along the path at which no joint exceeds its limits."""

    @abstractmethod
    def setpoint(self, way: float, speed: float, acceleration: float, last: Setpoint, seconds: float) -> Setpoint:
        """The joints after the distance `way`; `last` is the set-point of the path in the cycle before."""

    @abstractmethod
    def end(self, near: list[float]) -> list[float]:
        """The joints at the end of a path that has brought them to `near`."""

    def left(self, q: list[float]) -> float:
        """Distance of the TCP from the end when the joints are at `q`, m."""
        return math.dist(self._arm.pose(q)[:3], self.end_pose[:3])


class JointPath(MotionPath):
    """A straight line in joint space: six joints that start and arrive together. Lengths are those of the joint that
    moves furthest, in rad.
    """

    def __init__(self, arm: ArmWithTool, start: list[float], end: list[float]) -> None:
        super().__init__(arm)
        self._start, self._end = start, end
        way = [b - a for a, b in zip(start, end, strict=True)]
        self.length = max(map(abs, way))
        self._shares = [part / self.length for part in way] if self.length > 0.0 else list(REST)

    @cached_property
    def end_pose(self) -> list[float]:
        return self._arm.pose(self._end)

    def fastest(self) -> tuple[float, float]:
        limits = self._arm.limits
        return _within(limits.speed, self._shares), _within(limits.acceleration, self._shares)

    def setpoint(self, way: float, speed: float, acceleration: float, last: Setpoint, seconds: float) -> Setpoint:
        return Setpoint(
            [a + way * share for a, share in zip(self._start, self._shares, strict=True)],
            [speed * share for share in self._shares],
            [acceleration * share for share in self._shares],
        )

    def end(self, near: list[float]) -> list[float]:
        return self._end


def _within(limits: Sequence[float], shares: Sequence[float]) -> float:
    return min((limit / abs(share) for limit, share in zip(limits, shares, strict=True) if share), default=1.0)


class ToolPath(MotionPath):
    """A path of the TCP along a curve, from close to the joint positions `near`, by the inverse kinematics."""

    def __init__(self, arm: ArmWithTool, curve: Curve, near: list[float]) -> None:
        super().__init__(arm)
        self._curve, self._near = curve, near
        self.length = max(curve.length, RADIAN * curve.turn)
        self._end_joints: list[float] | None = None

    @property
    def end_pose(self) -> list[float]:
        return self._curve.end

    def fastest(self) -> tuple[float, float]:
        """The largest speed and acceleration along the path at which no joint exceeds its limits, by samples of it.

        The part behind a singular posture, or out of reach, does not count: the arm does not get there.
        """
        limits, part = self._arm.limits, self.length / _SAMPLES
        speed = acceleration = math.inf
        old = self._near
        for sample in range(1, _SAMPLES + 1):
            try:
                new = self._arm.joints(self._curve.pose(sample / _SAMPLES), old)
            except LimitViolation:
                break
            ways = [abs(b - a) for a, b in zip(old, new, strict=True)]
            if max(ways) > _JUMP:
                break
            for way, fastest, hardest in zip(ways, limits.speed, limits.acceleration, strict=True):
                if way > 0.0:
                    speed, acceleration = min(speed, fastest * part / way), min(acceleration, hardest * part / way)
            old = new
        return speed, acceleration

    def setpoint(self, way: float, speed: float, acceleration: float, last: Setpoint, seconds: float) -> Setpoint:
        """The joints after the distance `way`; `last` is the set-point of the cycle before.

        Raises:
            LimitViolation: the pose is out of reach.
        """
        if not speed and not acceleration:
            return Setpoint(last.q, REST, REST)
        return self._arm.setpoint(self._curve.pose(way / self.length), last, seconds)

    def end(self, near: list[float]) -> list[float]:
        """The joints at the end, on the branch of the inverse kinematics that they come from.

        Raises:
            LimitViolation: the end is out of reach on this branch.
        """
        if self._end_joints is None:
            self._end_joints = self._arm.joints(self.end_pose, near)
        return self._end_joints


class PathMove(Command):
    """One path move. It is over at its end, or within the blend radius of it, in the second half of its length.

    That a blend never begins in the first half is a guess: a controller ignores blends that overlap.
    """

    def __init__(self, path: MotionPath, profile: Trapezoid, start: list[float], blend: Blend | None, r: float) -> None:
        self._path, self._profile, self._blend, self._radius = path, profile, blend, r
        self._time = 0.0
        self._way = (0.0, 0.0)
        self._last = Setpoint(start, REST, REST)

    @property
    def blends(self) -> bool:
        """Whether the program has gone on, while the arm has not arrived: the next movement begins from this one."""
        return self.is_over and not self.is_at_rest and self._way[1] > 0.0

    def corner(self) -> tuple[list[float], float]:
        """Where the joints would come to rest, and in how many seconds, if they slowed down evenly from now on."""
        way, speed = self._way
        return self._path.end(self._last.q), 2.0 * (self._profile.length - way) / speed

    def advance(self, last: Setpoint, seconds: float, scaling: float, change: float) -> Setpoint:
        """The set-point one cycle later."""
        time = self._time + (scaling - 0.5 * change) * seconds
        arrives = time >= self._profile.duration
        if arrives:
            setpoint = Setpoint(self._path.end(self._last.q), REST, REST)
            way, speed = self._profile.length, 0.0
        else:
            way, speed, acceleration = self._profile.at(time)
            acceleration = acceleration * scaling * scaling + speed * change / seconds
            speed *= scaling
            setpoint = self._path.setpoint(way, speed, acceleration, self._last, seconds)
        self._time, self._way, self._last = time, (way, speed), setpoint
        if self._blend is not None:
            q, qd, qdd = self._blend.advance(seconds)
            if self._blend.is_over:
                self._blend = None
            else:
                setpoint = Setpoint(
                    [a + b for a, b in zip(setpoint.q, q, strict=True)],
                    [a + b for a, b in zip(setpoint.qd, qd, strict=True)],
                    [a + b for a, b in zip(setpoint.qdd, qdd, strict=True)],
                )
        if arrives and self._blend is None:
            self.is_at_rest = self.is_over = True
        elif self._blend_begins(way, setpoint.q):
            # Computed now, so that a corner out of reach is a violation in this cycle.
            self._path.end(self._last.q)
            self.is_over = True
        return setpoint

    def _blend_begins(self, way: float, q: list[float]) -> bool:
        if self.is_over or not self._radius or way < 0.5 * self._profile.length:
            return False
        return self._path.left(q) <= self._radius

    def restart(self, blend: Blend) -> None:
        """Continue from rest elsewhere: the blend leads back to the path."""
        self._blend = blend
        self._last = Setpoint(self._last.q, REST, REST)
        self._way = (self._way[0], 0.0)

    @property
    def end_pose(self) -> list[float]:
        """The pose of the TCP at the end, m and rad."""
        return list(self._path.end_pose)

    @property
    def place(self) -> list[float]:
        """The joints on the path itself, without the rest of an older one."""
        return self._last.q

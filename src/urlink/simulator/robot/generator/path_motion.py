"""Path moves from rest to rest: joint motions, lines and arcs.

The commands are movej for joint motions, movel, movep and servoc for lines, and movec for arcs. A `MotionPath` returns
the joint positions at a distance along the path. A `Trapezoid` returns this distance as a function of time. It consists
of acceleration, constant speed and deceleration, like the drawing in the manual of the pendant (cited from memory). A
`Blend` takes over the speed of the previous motion. The blending of real controllers is not published, so it is
assumed.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from functools import cached_property
from itertools import accumulate, islice, repeat

import numpy as np

from urlink.arm.curves import Curve
from urlink.arm.parameters import number
from urlink.arm.vectors import FloatArray

from ..setpoint_sources import REST, Setpoint
from .joint_limits import ArmWithTool, LimitViolation

#: Length, in m, to which a rotation of 1 rad is converted (assumed). The length of a tool path is at least the
#: converted rotation, so that a rotation without a translation takes time.
RADIAN = number("metres_per_turn_simulated")

# Number of samples of a tool path from which its maximum speed is computed, and difference in rad between two samples
# above which a joint jumps because of a singularity.
_SAMPLES, _JUMP = 64, 0.5


class Command(ABC):
    """Motion command that has begun.

    Attributes:
        is_over: Whether the URScript function that began the command returns now. It returns when the motion has ended,
            has come within the blend radius of its target, has lasted as long as requested, or was preempted.
        is_at_rest: Whether the joints are at rest, and stay at rest until the next command.
        overrun: Scaled time, in s, by which the last cycle exceeded the requested duration.
    """

    is_over = is_at_rest = False
    overrun = 0.0

    @abstractmethod
    def advance(self, last: Setpoint, seconds: float, scaling: float, change: float) -> Setpoint:
        """Return the set-point one cycle after `last`.

        Args:
            last: Previous set-point.
            seconds: Duration of the cycle, in s.
            scaling: Speed scaling at the end of the cycle.
            change: Change of the speed scaling over the cycle.
        """


# -- speed profiles ------------------------------------------------------------------------------------


class Trapezoid:
    """Speed profile from rest to rest over a given length, in the shortest time that the limits allow.

    The limits are a maximum speed, an acceleration and a deceleration. As a function of time, the speed is a trapezoid,
    or a triangle if the length is too short to reach the maximum speed.

    Attributes:
        length: Length of the path, in m or rad, like the speed and the accelerations.
        duration: Duration, in s.
        peak: Highest speed of the profile.
    """

    def __init__(self, length: float, speed: float, acceleration: float, rise: float | None = None) -> None:
        """Compute the profile.

        Args:
            length: Length of the path.
            speed: Maximum speed.
            acceleration: Deceleration at the end of the path.
            rise: Acceleration at the beginning of the path; None selects `acceleration`.
        """
        rise = acceleration if rise is None else rise
        # Accelerating to a speed v and decelerating from v need a length of v² times this number.
        ramps = 0.5 / rise + 0.5 / acceleration
        peak = min(speed, math.sqrt(length / ramps))
        self.length, self.peak = length, peak
        self._rise, self._fall = rise, acceleration
        self._up = peak / rise
        cruise = max(length / peak - peak * ramps, 0.0) if peak > 0.0 else 0.0
        self._down = self._up + cruise
        self.duration = self._down + peak / acceleration

    def course(self, times: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the same as `at`, to the last bit, for several times before the end, shape (n,)."""
        rises, cruises, left = times < self._up, times < self._down, self.duration - times
        return (
            np.where(
                rises,
                0.5 * self._rise * times * times,
                np.where(cruises, self.peak * (times - 0.5 * self._up), self.length - 0.5 * self._fall * left * left),
            ),
            np.where(rises, self._rise * times, np.where(cruises, self.peak, self._fall * left)),
            np.where(rises, self._rise, np.where(cruises, 0.0, -self._fall)),
        )

    def at(self, time: float) -> tuple[float, float, float]:
        """Return the distance, the speed and the acceleration `time` seconds after the start.

        After `duration`, the distance is `length`, and the speed is zero.
        """
        if time >= self.duration:
            return self.length, 0.0, 0.0
        if time < self._up:
            return 0.5 * self._rise * time * time, self._rise * time, self._rise
        if time < self._down:
            return self.peak * (time - 0.5 * self._up), self.peak, 0.0
        left = self.duration - time
        return self.length - 0.5 * self._fall * left * left, self._fall * left, -self._fall


def timed(length: float, duration: float, speed: float, acceleration: float) -> tuple[float, float]:
    """Return the speed and the acceleration with which a motion over a length takes `duration` seconds.

    If the limits allow it, acceleration, constant speed and deceleration take a third of the time each. Otherwise the
    maximum acceleration is used. If the limits do not allow this duration, the motion takes the shortest possible time.
    The choice of a real controller is unknown.

    Args:
        length: Length of the path.
        duration: Requested duration, in s.
        speed: Maximum speed.
        acceleration: Maximum acceleration.
    """
    even = 1.5 * length / duration, 4.5 * length / duration**2
    if even[0] <= speed and even[1] <= acceleration:
        return even
    # With the maximum acceleration, length / v + v / acceleration = duration.
    root = (acceleration * duration) ** 2 - 4.0 * acceleration * length
    if root < 0.0:
        return speed, acceleration
    return min(0.5 * (acceleration * duration - math.sqrt(root)), speed), acceleration


# -- blends --------------------------------------------------------------------------------------------


class Blend:
    """Transition from the previous motion to a path: a difference that is added to the set-points of the path.

    A path begins at rest, at a position where the arm could come to rest. The blend begins with the difference between
    the current position and the start of the path, and with the current speed. It ends with zero difference and zero
    speed. For each joint, the difference is a cubic polynomial of the time. Therefore the sum of path and blend changes
    from the old motion to the path with a continuous speed. If the difference is half the speed times the duration, the
    polynomial is a parabola, so that the deceleration is constant.

    Attributes:
        duration: Duration, in s.
    """

    def __init__(
        self, way: Sequence[float], qd: Sequence[float], duration: float, acceleration: Sequence[float]
    ) -> None:
        """Compute the blend. Its duration is increased if a joint would exceed its maximum acceleration.

        Args:
            way: Distance of each joint to the start of the path, in rad.
            qd: Current speed of each joint, in rad/s.
            duration: Minimum duration, in s.
            acceleration: Maximum acceleration of each joint, in rad/s².
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
        # With u = time / duration, q = -way + b u + c u² + e u³. At u = 1, q and its derivative are zero.
        self._cubics = [
            (-d, v * duration, 3.0 * d - 2.0 * v * duration, v * duration - 2.0 * d)
            for d, v in zip(way, qd, strict=True)
        ]

    @property
    def is_over(self) -> bool:
        """Whether the blend has ended, so that it adds nothing to the path."""
        return self._time >= self.duration

    def advance(self, seconds: float) -> tuple[list[float], list[float], list[float]]:
        """Advance by `seconds`, and return the positions, speeds and accelerations to add to the path."""
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
    """Path of the arm: the joint positions as a function of the distance along the path.

    Attributes:
        length: Length of the path: for a joint path, the distance of the joint that moves furthest, in rad; for a tool
            path, the distance of the TCP, in m.
    """

    length: float

    def __init__(self, arm: ArmWithTool) -> None:
        self._arm = arm

    @property
    @abstractmethod
    def end_pose(self) -> list[float]:
        """Pose of the TCP at the end of the path, in m and rad."""

    @abstractmethod
    def fastest(self) -> tuple[float, float]:
        """Return the maximum speed and acceleration along the path at which no joint exceeds its limits."""

    @abstractmethod
    def setpoint(self, way: float, speed: float, acceleration: float, last: Setpoint, seconds: float) -> Setpoint:
        """Return the set-point at the distance `way`; `last` is the previous set-point of the path."""

    @abstractmethod
    def end(self, near: list[float]) -> list[float]:
        """Return the joint positions at the end of the path; `near` are the last joint positions on the path."""

    def left(self, q: list[float]) -> float:
        """Return the distance of the TCP from the end of the path, in m, for joint positions `q`."""
        return math.dist(self._arm.pose(q)[:3], self.end_pose[:3])


class JointPath(MotionPath):
    """Straight line in joint space: all six joints start and arrive together.

    Its length is the distance of the joint that moves furthest, in rad.
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

    def course(self, way: FloatArray, speed: FloatArray, acceleration: FloatArray) -> FloatArray:
        """Return the positions, speeds and accelerations of several set-points, shape (3, n, 6); see `setpoint`."""
        along = np.multiply.outer(np.array((way, speed, acceleration)), self._shares)
        along[0] += self._start
        return along


def _within(limits: Sequence[float], shares: Sequence[float]) -> float:
    return min((limit / abs(share) for limit, share in zip(limits, shares, strict=True) if share), default=1.0)


class ToolPath(MotionPath):
    """Path of the TCP along a curve. Inverse kinematics compute the joint positions, beginning near `near`."""

    def __init__(self, arm: ArmWithTool, curve: Curve, near: list[float]) -> None:
        super().__init__(arm)
        self._curve, self._near = curve, near
        self.length = max(curve.length, RADIAN * curve.turn)
        self._end_joints: list[float] | None = None

    @property
    def end_pose(self) -> list[float]:
        return self._curve.end

    def fastest(self) -> tuple[float, float]:
        """Return the maximum speed and acceleration at which no joint exceeds its limits, computed from samples.

        Samples after a singular posture, or out of reach, are ignored, because the arm does not get there.
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
        """Return the set-point at the distance `way`; `last` is the previous set-point of the path.

        Raises:
            LimitViolation: If the pose is out of reach.
        """
        if not speed and not acceleration:
            return Setpoint(last.q, REST, REST)
        return self._arm.setpoint(self._curve.pose(way / self.length), last, seconds)

    def end(self, near: list[float]) -> list[float]:
        """Return the joint positions at the end of the path, on the current branch of the inverse kinematics.

        Raises:
            LimitViolation: If the end of the path is out of reach on this branch.
        """
        if self._end_joints is None:
            self._end_joints = self._arm.joints(self.end_pose, near)
        return self._end_joints


class PathMove(Command):
    """Path move. It is over when the arm has reached the end of the path, or is within the blend radius of the end.

    A blend begins only in the second half of the path. This is assumed, because a controller ignores blends that
    overlap.
    """

    def __init__(self, path: MotionPath, profile: Trapezoid, start: list[float], blend: Blend | None, r: float) -> None:
        self._path, self._profile, self._blend, self._radius = path, profile, blend, r
        self._time = 0.0
        self._way = (0.0, 0.0)
        self._last = Setpoint(start, REST, REST)

    @property
    def blends(self) -> bool:
        """Whether the move is over although the arm still moves, so that the next motion blends with this one."""
        return self.is_over and not self.is_at_rest and self._way[1] > 0.0

    def corner(self) -> tuple[list[float], float]:
        """Return the joint positions at the end of the path, and the time to get there.

        The time is in s, for a constant deceleration from the current speed.
        """
        way, speed = self._way
        return self._path.end(self._last.q), 2.0 * (self._profile.length - way) / speed

    def advance(self, last: Setpoint, seconds: float, scaling: float, change: float) -> Setpoint:
        """Return the set-point one cycle later."""
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
            # Compute the end of the path now, so that an end out of reach raises `LimitViolation` in this cycle.
            self._path.end(self._last.q)
            self.is_over = True
        return setpoint

    def course(self, cycles: int, seconds: float, scaling: float) -> FloatArray | None:
        """Return the set-points of the next cycles before the arrival, with an unchanged scaling.

        Return:
            Positions, speeds and accelerations, shape (3, n, 6), for at most `cycles` cycles. They equal those of
            `advance`, to the last bit. None if they are only known cycle by cycle.
        """
        if self._blend is not None or self._radius or self.is_over or not isinstance(self._path, JointPath):
            return None
        times = np.fromiter(self._times(cycles, seconds, scaling), np.float64)
        way, speed, acceleration = self._profile.course(times[times < self._profile.duration])
        return self._path.course(way, speed * scaling, acceleration * scaling * scaling)

    def advance_along(self, cycles: int, seconds: float, scaling: float, last: Setpoint) -> None:
        """Advance by this number of cycles of `course`, to the set-point `last`."""
        for time in self._times(cycles, seconds, scaling):
            self._time = time
        way, speed, _ = self._profile.at(self._time)
        self._way, self._last = (way, speed * scaling), last

    def _times(self, cycles: int, seconds: float, scaling: float) -> Iterator[float]:
        """Yield the time on the profile after each cycle, in s."""
        return islice(accumulate(repeat(scaling * seconds, cycles), initial=self._time), 1, None)

    def _blend_begins(self, way: float, q: list[float]) -> bool:
        if self.is_over or not self._radius or way < 0.5 * self._profile.length:
            return False
        return self._path.left(q) <= self._radius

    def restart(self, blend: Blend) -> None:
        """Continue from another position at which the arm has stopped; the blend returns to the path."""
        self._blend = blend
        self._last = Setpoint(self._last.q, REST, REST)
        self._way = (self._way[0], 0.0)

    @property
    def end_pose(self) -> list[float]:
        """Pose of the TCP at the end of the path, in m and rad."""
        return list(self._path.end_pose)

    @property
    def place(self) -> list[float]:
        """Current joint positions on the path itself, without the blend from an older motion."""
        return self._last.q

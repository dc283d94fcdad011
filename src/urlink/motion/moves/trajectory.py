"""Timed joint trajectories: points with times, and the curve through the points.

Between two points, the curve of each joint is a cubic polynomial if the points have velocities. If the points also have
accelerations, the curve is a quintic polynomial. The curve passes through every point with exactly the values of the
point.

If the points have no velocities, the velocity is zero at both ends of the trajectory. The points in between get the
velocities of a monotone cubic curve (Fritsch and Carlson, with the weighted harmonic mean that is known as PCHIP).
Between two points, this curve never leaves the range between the positions of these points. As in every cubic curve,
the acceleration jumps at the points.
"""

from __future__ import annotations

import math
import os
from bisect import bisect_right
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from linkcore.arguments import other_unit
from linkcore.errors import BadValue
from linkcore.names import StrictAttributes

from ...arm.models import Model
from ...arm.vectors import JOINTS, FloatArray, numbers, six, six_limits
from .retiming import retime
from .trajectory_files import plot, read_points, write_points

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from ...arm.kinematics import Arm

#: Shortest time between two points, in s. A shorter time is rejected, because no controller has a cycle below 2 ms.
_CLOSEST = 1e-4
#: Largest accepted number, in rad, rad/s, rad/s² and s.
_LARGEST = 1e6
#: Number of places in each segment at which `Trajectory.check` evaluates the curve. Between two places, the curve
#: exceeds the evaluated values by less than 1 % of its range, even if a segment oscillates as much as possible.
_PLACES = 17
#: Fraction by which a value may exceed a limit, because of rounding.
_SLACK = 1e-6
#: Joint speed in rad/s below which an arm counts as at rest at the beginning and the end of a trajectory.
_STANDING = 0.05
#: Largest turn of a joint between two poses, in rad. A larger turn means that the poses pass through a singularity.
LEAP = 1.5

_QUANTITIES = (("q", "rad"), ("qd", "rad/s"), ("qdd", "rad/s²"))


@dataclass(frozen=True, eq=False, init=False)
class TrajectoryPoint:
    """Positions of the joints at one time. Arrays are read-only, with the joints from base to wrist 3.

    Attributes:
        q: Positions, shape (6,), in rad.
        time: Time in seconds since the trajectory began.
        qd: Velocities, shape (6,), in rad/s; None if the trajectory calculates the velocities.
        qdd: Accelerations, shape (6,), in rad/s²; None if the accelerations are not prescribed.

    Raises:
        BadValue: If an array is not six finite numbers.
    """

    q: FloatArray
    time: float
    qd: FloatArray | None
    qdd: FloatArray | None

    def __init__(self, q: ArrayLike, time: float, qd: ArrayLike | None = None, qdd: ArrayLike | None = None) -> None:
        object.__setattr__(self, "q", six(q, "q"))
        if np.ndim(time) != 0:
            raise BadValue(f"time is {time!r}; expected one number of seconds")
        object.__setattr__(self, "time", float(numbers(time, "time")))
        object.__setattr__(self, "qd", None if qd is None else six(qd, "qd"))
        object.__setattr__(self, "qdd", None if qdd is None else six(qdd, "qdd"))


class Trajectory(StrictAttributes):
    """Joint trajectory: points with times, and the curve through the points.

    Args:
        points: At least two points. The time of the first point must be 0, and times must increase. Either all points
            must have velocities, or none of them. The same applies to accelerations. Accelerations need velocities.

    Attributes:
        time: Times, shape (n,), in seconds.
        q: Positions, shape (n, 6), in rad.
        qd: Velocities, shape (n, 6), in rad/s; calculated if the points had no velocities.
        qdd: Accelerations, shape (n, 6), in rad/s², or None. All arrays are read-only.
        has_velocities: Whether the points had velocities.

    Raises:
        BadValue: If a point is invalid. The message names the point and the error.
    """

    time: FloatArray
    q: FloatArray
    qd: FloatArray
    qdd: FloatArray | None
    has_velocities: bool

    def __init__(self, points: Iterable[TrajectoryPoint]) -> None:
        points = list(points)
        for number, point in enumerate(points):
            if not isinstance(point, TrajectoryPoint):
                raise BadValue(f"point {number} is {point!r}; expected a TrajectoryPoint")
        self._build(
            np.array([point.time for point in points], dtype=np.float64),
            np.array([point.q for point in points], dtype=np.float64),
            _column([point.qd for point in points], "velocities"),
            _column([point.qdd for point in points], "accelerations"),
        )

    @classmethod
    def from_arrays(
        cls, time: ArrayLike, q: ArrayLike, qd: ArrayLike | None = None, qdd: ArrayLike | None = None
    ) -> Trajectory:
        """Make a trajectory from arrays.

        Args:
            time: Times, shape (n,), in s.
            q: Positions, shape (n, 6), in rad.
            qd, qdd: Velocities and accelerations, shape (n, 6), in rad/s and rad/s²; optional.

        Raises:
            BadValue: If a point is invalid; see `Trajectory`.
        """
        trajectory = cls.__new__(cls)
        trajectory._build(
            numbers(time, "time"),
            numbers(q, "q"),
            None if qd is None else numbers(qd, "qd"),
            None if qdd is None else numbers(qdd, "qdd"),
        )
        return trajectory

    @classmethod
    def from_poses(
        cls, time: ArrayLike, poses: ArrayLike, arm: Arm, near: ArrayLike, tcp: ArrayLike | None = None
    ) -> Trajectory:
        """Make a trajectory from poses of the tool.

        Each pose is converted to the joint positions that are closest to the previous ones. Between the poses, the
        joints move smoothly. The tool passes exactly through each pose. Between two poses, the tool deviates from a
        straight line. The deviation is smaller if the poses are closer together.

        Args:
            time: Times, shape (n,), in s.
            poses: Poses in the base frame, shape (n, 6), in m, with rotation vectors in rad.
            arm: Kinematics of the arm: ``robot.kinematics``, or an `urlink.kinematics.Arm`.
            near: Joint positions that the first pose should be close to, shape (6,), in rad.
            tcp: Pose of the TCP in the frame of the flange, shape (6,). If None, the poses are those of the flange.

        Raises:
            BadValue: If a point is invalid (see `Trajectory`), or if a joint would jump between two poses, for example
                at a singularity.
            Unreachable: If a pose is out of reach. The message names the row of the pose.
        """
        q = arm.inverse_path(poses, near, tcp)
        leaps = np.abs(np.diff(q, axis=0)) > LEAP
        if leaps.any():
            point, joint = (int(index) for index in np.argwhere(leaps)[0])
            raise BadValue(
                f"between points {point} and {point + 1} {JOINTS[joint]} (joint {joint}) jumps from "
                f"{q[point, joint]:.4f} to {q[point + 1, joint]:.4f} rad: the poses pass through a singularity, or are "
                "too far apart"
            )
        return cls.from_arrays(time, q)

    @classmethod
    def from_csv(cls, path: str | os.PathLike[str]) -> Trajectory:
        """Read a trajectory from a CSV file.

        The header is ``time,q0,...,q5``, optionally with ``qd0,...,qd5``, and with ``qdd0,...,qdd5``. Columns may be in
        any order. The units are the same as in `TrajectoryPoint`.

        Raises:
            BadValue: If the file cannot be read, or has a wrong format. The message names the line.
        """
        arrays, line = read_points(Path(path))
        try:
            return cls.from_arrays(*arrays)
        except BadValue as error:
            raise BadValue(f"{path} (point 0 is line {line}): {error}") from None

    def to_csv(self, path: str | os.PathLike[str]) -> None:
        """Write a CSV file that `from_csv` can read, with all digits of the numbers.

        Velocities are written only if the points had velocities.

        Raises:
            BadValue: If the file cannot be written.
        """
        arrays = [self.time, self.q]
        if self.has_velocities:
            arrays.append(self.qd)
        if self.qdd is not None:
            arrays.append(self.qdd)
        write_points(Path(path), arrays)

    def _build(self, time: FloatArray, q: FloatArray, qd: FloatArray | None, qdd: FloatArray | None) -> None:
        if time.ndim != 1 or time.size < 2:
            raise BadValue(f"time has the shape {time.shape}; expected at least two points in time")
        for (name, unit), array in zip(_QUANTITIES, (q, qd, qdd), strict=True):
            if array is None:
                continue
            if array.shape != (time.size, 6):
                raise BadValue(f"{name} has the shape {array.shape}; expected {(time.size, 6)}, six joints per point")
            bad = ~(np.abs(array) <= _LARGEST)
            if bad.any():
                point, joint = (int(index) for index in np.argwhere(bad)[0])
                raise BadValue(
                    f"point {point}: {name}[{joint}] ({JOINTS[joint]}) is {array[point, joint]}; "
                    f"expected a finite number of {unit}"
                )
        if qdd is not None and qd is None:
            raise BadValue("the trajectory has accelerations without velocities; a quintic curve needs both")
        _check_times(time)
        self.has_velocities = qd is not None
        qd = _chosen_velocities(time, q) if qd is None else qd
        for array in (time, q, qd, qdd):
            if array is not None:
                array.flags.writeable = False
        self.time, self.q, self.qd, self.qdd = time, q, qd, qdd
        self._coefficients = _coefficients(time, q, qd, qdd)
        # Plain floats are used for single times, because numpy takes as long for six numbers as for a hundred.
        self._times: list[float] = time.tolist()
        self._rows: list[list[list[float]]] = self._coefficients.transpose(0, 2, 1).tolist()
        self._ends: list[list[float]] = [q[0].tolist(), q[-1].tolist()]

    @property
    def duration(self) -> float:
        """Time in seconds from the first to the last point."""
        return self._times[-1]

    @property
    def is_quintic(self) -> bool:
        """Whether the points prescribe accelerations."""
        return self.qdd is not None

    @property
    def points(self) -> tuple[TrajectoryPoint, ...]:
        """Points of the trajectory; calculated velocities are left out."""
        return tuple(
            TrajectoryPoint(
                self.q[i],
                self._times[i],
                self.qd[i] if self.has_velocities else None,
                None if self.qdd is None else self.qdd[i],
            )
            for i in range(len(self))
        )

    def __len__(self) -> int:
        return len(self._times)

    def __repr__(self) -> str:
        return f"<Trajectory of {len(self)} points in {self.duration:g} s>"

    def at(self, t: ArrayLike) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return positions, velocities and accelerations at the times `t`.

        For one time, each result has shape (6,); for an array of times, (..., 6). Before the first point, the curve is
        at rest at the first point. After the last point, it is at rest at the last point.

        Raises:
            BadValue: If a time is not a number.
        """
        times = numbers(t, "t")
        if np.isnan(times).any():
            raise BadValue("t contains NaN; expected numbers")
        if times.ndim == 0:
            q, qd, qdd = self.sample(float(times))
            return np.array(q), np.array(qd), np.array(qdd)
        return self._curve(times)

    def sample(self, t: float) -> tuple[list[float], list[float], list[float]]:
        """Return the same as `at` for one time, as plain floats for control loops. If `t` is NaN, return the end."""
        times = self._times
        if not 0.0 <= t <= times[-1]:
            rest = [0.0] * 6
            return list(self._ends[0 if t < 0.0 else 1]), rest, rest
        # The last point belongs to the last segment.
        i = bisect_right(times, t, 1, len(times) - 1) - 1
        h = times[i + 1] - times[i]
        u = (t - times[i]) / h
        q, qd, qdd = [], [], []
        for c0, c1, c2, c3, c4, c5 in self._rows[i]:
            q.append(c0 + u * (c1 + u * (c2 + u * (c3 + u * (c4 + u * c5)))))
            qd.append((c1 + u * (2.0 * c2 + u * (3.0 * c3 + u * (4.0 * c4 + u * (5.0 * c5))))) / h)
            qdd.append((2.0 * c2 + u * (6.0 * c3 + u * (12.0 * c4 + u * (20.0 * c5)))) / (h * h))
        return q, qd, qdd

    def _curve(self, t: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        inside = np.clip(t, 0.0, self.duration)
        i = np.clip(np.searchsorted(self.time, inside, side="right") - 1, 0, len(self) - 2)
        h = np.asarray(self.time[i + 1] - self.time[i])[..., None]
        u = np.asarray(inside - self.time[i])[..., None] / h
        c0, c1, c2, c3, c4, c5 = np.moveaxis(self._coefficients[i], -2, 0)
        q = c0 + u * (c1 + u * (c2 + u * (c3 + u * (c4 + u * c5))))
        qd = (c1 + u * (2.0 * c2 + u * (3.0 * c3 + u * (4.0 * c4 + u * (5.0 * c5))))) / h
        qdd = (2.0 * c2 + u * (6.0 * c3 + u * (12.0 * c4 + u * (20.0 * c5)))) / (h * h)
        outside = (t < 0.0) | (t > self.duration)
        if outside.any():
            qd[outside] = qdd[outside] = 0.0
            q[outside] = np.where((t < 0.0)[outside][..., None], self.q[0], self.q[-1])
        return q, qd, qdd

    # -- time --------------------------------------------------------------------------------------

    def retimed(self, speed: ArrayLike, acceleration: ArrayLike) -> Trajectory:
        """Return a trajectory with the same path and the shortest duration within limits, from rest to rest.

        The new trajectory comes to rest at all places at which all joints of this trajectory are at rest. The times of
        the points have no effect. The limits of an arm are not checked: see `check`. Jerk is not limited, so
        accelerations jump. Retiming takes about a millisecond of processor time per point.

        Args:
            speed: Largest speed in rad/s, one number for all joints, or shape (6,).
            acceleration: Largest acceleration in rad/s², one number for all joints, or shape (6,).

        Returns:
            A trajectory with velocities. It has 3 to 200 points for each segment of this trajectory, and at least a few
            hundred points in total.

        Raises:
            BadValue: If a limit is not positive, or if the trajectory does not move.
        """
        limits = six_limits(speed, "speed"), six_limits(acceleration, "acceleration")
        segments = len(self) - 1
        places = min(max(math.ceil(200 / segments), 20), max(math.ceil(2000 / segments), 3))
        # The places are closer together near the points, because the curve bends most there.
        parts = 0.5 - 0.5 * np.cos(np.linspace(0.0, math.pi, places + 1)[:-1])
        times = np.append((self.time[:-1, None] + np.diff(self.time)[:, None] * parts).ravel(), self.duration)
        q, qd, _ = self._curve(times)
        return Trajectory.from_arrays(*retime(q, qd, *limits, closest=2.0 * _CLOSEST))

    # -- limits ------------------------------------------------------------------------------------

    def check(self, model: Model | None = None, near: ArrayLike | None = None, *, within: float = 0.05) -> None:
        """Raise an error if an arm could not follow the trajectory, or should not begin it.

        The curve is evaluated at every point, and at 15 places between two neighbouring points.

        Args:
            model: Model of the arm, with the limits of position, velocity and acceleration. If None, limits are not
                checked. The limits of acceleration are approximate: see `urlink.models`.
            near: Current joint positions, shape (6,), in rad. The first point must not be further away than `within` in
                any joint, and the arm must be at rest at both ends of the trajectory. If None, neither is checked.
            within: Largest distance in rad.

        Raises:
            BadValue: If a limit is exceeded. The message contains the point, the joint, the value and the limit.
        """
        if near is not None:
            self._check_ends(six(near, "near"), within)
        if model is None:
            return
        u = np.linspace(0.0, 1.0, _PLACES)
        # Segments are checked in blocks, so that a long trajectory does not need gigabytes of memory.
        for first in range(0, len(self) - 1, 4096):
            segments = np.arange(first, min(first + 4096, len(self) - 1))
            times = self.time[segments][:, None] + u * np.diff(self.time)[segments][:, None]
            times[:, -1] = self.time[segments + 1]
            q, qd, qdd = self._curve(times)
            refuse = partial(refuse_beyond, partial(self._place, times), f"a {model.name}")
            low, high = model.position_limits.T
            below, above = q < low, q > high
            refuse(q, "position", "rad", np.where(below, low, high), below | above)
            for values, limit, name, unit in (
                (qd, model.max_speed, "velocity", "rad/s"),
                (qdd, model.max_acceleration, "acceleration", "rad/s²"),
            ):
                beyond = np.abs(values) > limit * (1.0 + _SLACK)
                refuse(values, name, unit, np.broadcast_to(limit, values.shape), beyond)

    def _place(self, times: FloatArray, segment: int, place: int) -> str:
        """Describe one of the times for error messages; the shape of `times` is (segments, places)."""
        t = times[segment, place]
        after = int(np.searchsorted(self.time, t, side="right")) - 1
        where = f"point {after}" if t == self.time[after] else f"between points {after} and {after + 1}"
        return f"{where} (t = {t:.4f} s)"

    def plot(self, model: Model | None = None) -> Figure:
        """Plot positions, speeds and accelerations over time with matplotlib.

        For example, ``plot().savefig("it.png")`` saves the plot.

        Args:
            model: Model of the arm. The limits of speed and acceleration of this model are drawn; None for no limits.

        Raises:
            LocalError: If matplotlib is not installed (``pip install 'urlink-robot[plot]'``).
        """
        return plot(self.time, self.q, self.at, model)

    def _check_ends(self, near: FloatArray, within: float) -> None:
        away = np.abs(self.q[0] - near)
        if (away > within).any():
            joint = int(np.argmax(away))
            raise BadValue(
                f"the first point is too far from the position of the arm: {JOINTS[joint]} (joint {joint}) is at "
                f"{near[joint]:.4f} rad, but begins at {self.q[0, joint]:.4f} rad; at most {within:g} rad is allowed"
            )
        for point, speeds in ((0, self.qd[0]), (len(self) - 1, self.qd[-1])):
            joint = int(np.argmax(np.abs(speeds)))
            if abs(speeds[joint]) > _STANDING:
                raise BadValue(
                    f"point {point}: {JOINTS[joint]} (joint {joint}) moves at {speeds[joint]:.4f} rad/s; a trajectory "
                    "must begin and end at rest"
                )


def refuse_beyond(
    where: Callable[[int, int], str],
    whose: str,
    values: FloatArray,
    what: str,
    unit: str,
    limits: FloatArray,
    beyond: np.ndarray[tuple[int, ...], np.dtype[np.bool_]],
) -> None:
    """Raise an error if a value of a curve, shape (segments, places, joints), exceeds its limit.

    Args:
        where: Function that returns a description of a place for the error message. Its arguments are the number of the
            segment, and the number of the place in this segment.
        whose: Owner of the limits, such as "a UR5e", for the error message.
        values, what, unit: Values of the joints, name of the quantity, and unit.
        limits: Exceeded limits. The entries for values that are not `beyond` are ignored.
        beyond: Whether each value exceeds its limit.

    Raises:
        BadValue: If a value exceeds its limit.
    """
    if not beyond.any():
        return
    segment, place, joint = (int(index) for index in np.argwhere(beyond)[0])
    value, limit = float(values[segment, place, joint]), float(limits[segment, place, joint])
    raise BadValue(
        f"{where(segment, place)}: {what} of {JOINTS[joint]} (joint {joint}) is {value:.4f} {unit}; the limit of "
        f"{whose} is {limit:.4f} {unit}" + other_unit(abs(value), unit, 0.0, abs(limit))
    )


def _column(values: Sequence[FloatArray | None], name: str) -> FloatArray | None:
    """Return all values as one array; None if all values are None."""
    given = [value for value in values if value is not None]
    if not given:
        return None
    if len(given) != len(values):
        which = next(i for i, value in enumerate(values) if (value is None) != (values[0] is None))
        raise BadValue(f"point {which}: either all points have {name} or none; this one differs from the first")
    return np.array(given, dtype=np.float64)


def _check_times(time: FloatArray) -> None:
    bad = ~(np.abs(time) <= _LARGEST)
    if bad.any():
        raise BadValue(f"point {int(np.argmax(bad))}: time is {time[bad][0]}; expected a finite number of seconds")
    if time[0] != 0.0:
        raise BadValue(f"point 0: time is {time[0]:g} s; a trajectory begins at 0, so subtract this from all times")
    is_close = np.diff(time) < _CLOSEST
    if is_close.any():
        after = int(np.argmax(is_close)) + 1
        raise BadValue(
            f"point {after}: time {time[after]:.9g} s follows {time[after - 1]:.9g} s; times must increase by at least "
            f"{_CLOSEST:g} s"
        )


def _chosen_velocities(time: FloatArray, q: FloatArray) -> FloatArray:
    """Calculate velocities: zero at both ends, and those of a monotone cubic curve in between."""
    h = np.diff(time)[:, None]
    slope = np.diff(q, axis=0) / h
    qd = np.zeros_like(q)
    before, after = slope[:-1], slope[1:]
    ha, hb = h[:-1], h[1:]
    first, second = 2.0 * hb + ha, hb + 2.0 * ha
    # The velocity is zero if the direction reverses, because the point is then an extremum. The signs are multiplied
    # instead of the slopes, because a product of slopes can underflow.
    goes_on = np.sign(before) * np.sign(after) > 0.0
    before, after = np.where(goes_on, before, 1.0), np.where(goes_on, after, 1.0)
    # This is the weighted harmonic mean of the two slopes. The smaller slope is factored out, so that nothing
    # overflows.
    least = np.minimum(np.abs(before), np.abs(after))
    mean = least * (first + second) / (first * (least / np.abs(before)) + second * (least / np.abs(after)))
    qd[1:-1] = np.where(goes_on, np.sign(before) * mean, 0.0)
    return qd


def _coefficients(time: FloatArray, q: FloatArray, qd: FloatArray, qdd: FloatArray | None) -> FloatArray:
    """Return the coefficients, (segments, 6 powers of u, 6 joints); u increases from 0 to 1 in each segment."""
    h = np.diff(time)[:, None]
    way = np.diff(q, axis=0)
    v0, v1 = qd[:-1] * h, qd[1:] * h
    zero = np.zeros_like(way)
    if qdd is None:
        rows = [q[:-1], v0, 3.0 * way - 2.0 * v0 - v1, v0 + v1 - 2.0 * way, zero, zero]
    else:
        a0, a1 = qdd[:-1] * h * h, qdd[1:] * h * h
        rows = [
            q[:-1],
            v0,
            0.5 * a0,
            10.0 * way - 6.0 * v0 - 4.0 * v1 - 1.5 * a0 + 0.5 * a1,
            -15.0 * way + 8.0 * v0 + 7.0 * v1 + 1.5 * a0 - a1,
            6.0 * way - 3.0 * v0 - 3.0 * v1 - 0.5 * a0 + 0.5 * a1,
        ]
    return np.stack(rows, axis=1)

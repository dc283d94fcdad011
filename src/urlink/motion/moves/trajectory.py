"""Timed joint trajectories: points, and the curve through them.

Between two points the curve is a cubic polynomial per joint if the points have velocities, and a quintic one if they
have accelerations too: it passes through every point with exactly the values of the point. Points without velocities
get zero at both ends, and between them the velocities of a monotone cubic (Fritsch and Carlson, with the weighted
harmonic mean that is known as PCHIP), which never leaves the range between two neighbouring points. In return the
acceleration jumps at the points, as in every cubic.
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

#: s; points closer than this are a mistake: no controller has a cycle below 2 ms.
_CLOSEST = 1e-4
#: rad, rad/s, rad/s², s; a larger number is a mistake.
_LARGEST = 1e6
#: Places in each segment at which `Trajectory.check` evaluates the curve. Between two of them the curve exceeds the
#: values found by less than 1 % of its range, even if it oscillates as much as such a segment can.
_PLACES = 17
#: Fraction by which rounding may exceed a limit.
_SLACK = 1e-6
#: rad/s below which an arm counts as standing still, where a trajectory begins and ends.
_STANDING = 0.05
#: rad that a joint may turn between two poses; more means a singularity.
LEAP = 1.5

_QUANTITIES = (("q", "rad"), ("qd", "rad/s"), ("qdd", "rad/s²"))


@dataclass(frozen=True, eq=False, init=False)
class TrajectoryPoint:
    """The positions of the joints at one time. Arrays are read-only, joints from base to wrist 3.

    Attributes:
        q: (6,) positions, rad.
        time: seconds since the trajectory began.
        qd: (6,) velocities, rad/s; None if the trajectory chooses them.
        qdd: (6,) accelerations, rad/s²; None if they are not prescribed.

    Raises:
        BadValue: not six finite numbers.
    """

    q: FloatArray
    time: float
    qd: FloatArray | None
    qdd: FloatArray | None

    def __init__(self, q: ArrayLike, time: float, qd: ArrayLike | None = None, qdd: ArrayLike | None = None) -> None:
        object.__setattr__(self, "q", six(q, "q"))
        if np.ndim(time) != 0:
            raise BadValue(f"time: {time!r} is not one number of seconds")
        object.__setattr__(self, "time", float(numbers(time, "time")))
        object.__setattr__(self, "qd", None if qd is None else six(qd, "qd"))
        object.__setattr__(self, "qdd", None if qdd is None else six(qdd, "qdd"))


class Trajectory(StrictAttributes):
    """Points in time, and the curve through them.

    Args:
        points: at least two; the first at time 0, the times increasing. All of them have velocities or none, all have
            accelerations or none, and accelerations need velocities.

    Attributes:
        time: (n,) seconds.
        q: (n, 6) rad.
        qd: (n, 6) rad/s; the chosen ones if the points had none.
        qdd: (n, 6) rad/s², or None. All arrays are read-only.
        has_velocities: whether `qd` was given rather than chosen.

    Raises:
        BadValue: a point is invalid; the message names it, and what is wrong.
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
        """From times (n,) in s, positions (n, 6) in rad, and optionally velocities and accelerations (n, 6).

        Raises:
            BadValue: see `Trajectory`.
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
        """From poses of the tool: joint positions along them, each closest to the one before.

        Between the poses the joints move smoothly. The tool is exact at each pose; between them it is the more exact,
        the closer they are.

        Args:
            time: (n,) s.
            poses: (n, 6) in the base frame, m, and rotation vectors in rad.
            arm: kinematics of the arm: ``robot.kinematics``, or an `urlink.kinematics.Arm`.
            near: (6,) joint positions at the beginning, rad.
            tcp: (6,) pose of the TCP in the frame of the flange; None for the flange.

        Raises:
            BadValue: see `Trajectory`; or a joint would jump between two poses, as in a singularity.
            Unreachable: a pose is out of reach; the message names its row.
        """
        q = arm.inverse_path(poses, near, tcp)
        leaps = np.abs(np.diff(q, axis=0)) > LEAP
        if leaps.any():
            point, joint = (int(index) for index in np.argwhere(leaps)[0])
            raise BadValue(
                f"between points {point} and {point + 1} {JOINTS[joint]} (joint {joint}) leaps from "
                f"{q[point, joint]:.4f} to {q[point + 1, joint]:.4f} rad: the poses lead through a singularity, or are "
                "too far apart"
            )
        return cls.from_arrays(time, q)

    @classmethod
    def from_csv(cls, path: str | os.PathLike[str]) -> Trajectory:
        """From a file with the header ``time,q0,...,q5``, optionally with ``qd0,...,qd5``, and with ``qdd0,...,qdd5``.

        Columns may have any order. Units as in `TrajectoryPoint`.

        Raises:
            BadValue: the file cannot be read, or is not such a file; the message names the line.
        """
        arrays, line = read_points(Path(path))
        try:
            return cls.from_arrays(*arrays)
        except BadValue as error:
            raise BadValue(f"{path} (point 0 is line {line}): {error}") from None

    def to_csv(self, path: str | os.PathLike[str]) -> None:
        """Write what `from_csv` reads, with all digits; velocities only if they were given.

        Raises:
            BadValue: the file cannot be written.
        """
        arrays = [self.time, self.q]
        if self.has_velocities:
            arrays.append(self.qd)
        if self.qdd is not None:
            arrays.append(self.qdd)
        write_points(Path(path), arrays)

    def _build(self, time: FloatArray, q: FloatArray, qd: FloatArray | None, qdd: FloatArray | None) -> None:
        if time.ndim != 1 or time.size < 2:
            raise BadValue(f"a trajectory has at least two points in time; got times of shape {time.shape}")
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
            raise BadValue("accelerations without velocities; a quintic curve needs both")
        _check_times(time)
        self.has_velocities = qd is not None
        qd = _chosen_velocities(time, q) if qd is None else qd
        for array in (time, q, qd, qdd):
            if array is not None:
                array.flags.writeable = False
        self.time, self.q, self.qd, self.qdd = time, q, qd, qdd
        self._coefficients = _coefficients(time, q, qd, qdd)
        # As plain floats, for one time at a time: numpy takes as long for six numbers as for a hundred.
        self._times: list[float] = time.tolist()
        self._rows: list[list[list[float]]] = self._coefficients.transpose(0, 2, 1).tolist()
        self._ends: list[list[float]] = [q[0].tolist(), q[-1].tolist()]

    @property
    def duration(self) -> float:
        """Seconds from the first point to the last."""
        return self._times[-1]

    @property
    def is_quintic(self) -> bool:
        """Whether the points prescribe accelerations."""
        return self.qdd is not None

    @property
    def points(self) -> tuple[TrajectoryPoint, ...]:
        """The points, as they were given."""
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
        """Positions, velocities and accelerations at the times `t`: (6,) each for one time, (..., 6) for an array.

        Before the first and after the last point the curve stands still at that point.

        Raises:
            BadValue: a time is not a number.
        """
        times = numbers(t, "t")
        if np.isnan(times).any():
            raise BadValue("t is not a number")
        if times.ndim == 0:
            q, qd, qdd = self.sample(float(times))
            return np.array(q), np.array(qd), np.array(qdd)
        return self._curve(times)

    def sample(self, t: float) -> tuple[list[float], list[float], list[float]]:
        """As `at`, for one time and in plain floats, for control loops. NaN gives the end."""
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
        """The same path in the shortest time within limits, from rest to rest.

        Where all joints rest in this trajectory, they rest in the new one too. The times of the points have no effect.
        The limits of an arm are not checked: see `check`. Accelerations jump: jerk is not limited. It takes about a
        millisecond of processor time per point.

        Args:
            speed: largest speed, rad/s, of all joints or (6,) of each.
            acceleration: largest acceleration, rad/s², of all joints or (6,) of each.

        Returns:
            a trajectory with velocities, with 3 to 200 points for each step of this one, and a few hundred at least.

        Raises:
            BadValue: a limit is not positive, or the trajectory does not move.
        """
        limits = six_limits(speed, "speed"), six_limits(acceleration, "acceleration")
        segments = len(self) - 1
        places = min(max(math.ceil(200 / segments), 20), max(math.ceil(2000 / segments), 3))
        # Denser next to the points, where the curve bends most.
        parts = 0.5 - 0.5 * np.cos(np.linspace(0.0, math.pi, places + 1)[:-1])
        times = np.append((self.time[:-1, None] + np.diff(self.time)[:, None] * parts).ravel(), self.duration)
        q, qd, _ = self._curve(times)
        return Trajectory.from_arrays(*retime(q, qd, *limits, closest=2.0 * _CLOSEST))

    # -- limits ------------------------------------------------------------------------------------

    def check(self, model: Model | None = None, near: ArrayLike | None = None, *, within: float = 0.05) -> None:
        """Raise if an arm could not follow it, or should not begin it.

        The curve is evaluated at every point, and at 15 places between two neighbouring ones.

        Args:
            model: its limits of position, velocity and acceleration must hold; None leaves them unchecked. The
                accelerations are approximate, see `urlink.models`.
            near: (6,) present joint positions, rad; no joint of the first point may be further than `within` from them,
                and both ends must be at rest. None leaves this unchecked.
            within: rad.

        Raises:
            BadValue: a limit is exceeded; the message has the point, the joint, the value and the limit.
        """
        if near is not None:
            self._check_ends(six(near, "near"), within)
        if model is None:
            return
        u = np.linspace(0.0, 1.0, _PLACES)
        # In blocks of segments: a long trajectory must not take gigabytes.
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
        """One of these times, (segments, places), for messages."""
        t = times[segment, place]
        after = int(np.searchsorted(self.time, t, side="right")) - 1
        where = f"point {after}" if t == self.time[after] else f"between points {after} and {after + 1}"
        return f"{where} (t = {t:.4f} s)"

    def plot(self, model: Model | None = None) -> Figure:
        """Positions, speeds and accelerations over time, as a matplotlib figure: ``plot().savefig("it.png")``.

        Args:
            model: its limits of speed and acceleration are drawn as well; None for none.

        Raises:
            LocalError: matplotlib is not installed (``pip install 'urlink-robot[plot]'``).
        """
        return plot(self.time, self.q, self.at, model)

    def _check_ends(self, near: FloatArray, within: float) -> None:
        away = np.abs(self.q[0] - near)
        if (away > within).any():
            joint = int(np.argmax(away))
            raise BadValue(
                f"the first point is too far from where the arm is: {JOINTS[joint]} (joint {joint}) at "
                f"{near[joint]:.4f} rad, to begin at {self.q[0, joint]:.4f} rad; at most {within:g} rad apart"
            )
        for point, speeds in ((0, self.qd[0]), (len(self) - 1, self.qd[-1])):
            joint = int(np.argmax(np.abs(speeds)))
            if abs(speeds[joint]) > _STANDING:
                raise BadValue(
                    f"point {point}: {JOINTS[joint]} (joint {joint}) moves at {speeds[joint]:.4f} rad/s; an arm begins "
                    "and ends at rest"
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
    """Raise if one of the values of a curve, (segments, places, joints), is beyond its limit.

    Args:
        where: names a place by its segment and its number in that, for the message.
        whose: the limits are.
        values, what, unit: of the joints.
        limits: of the values; of those within, any.
        beyond: whether each value is.

    Raises:
        BadValue: one is.
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
    """All values as one array; None if all of them are None."""
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
        raise BadValue(f"point 0: time is {time[0]:g} s; a trajectory begins at 0, so subtract that from all times")
    is_close = np.diff(time) < _CLOSEST
    if is_close.any():
        after = int(np.argmax(is_close)) + 1
        raise BadValue(
            f"point {after}: time {time[after]:.9g} s after {time[after - 1]:.9g} s; times have to increase, by "
            f"{_CLOSEST:g} s at least"
        )


def _chosen_velocities(time: FloatArray, q: FloatArray) -> FloatArray:
    """Zero at both ends; between them those of a monotone cubic."""
    h = np.diff(time)[:, None]
    slope = np.diff(q, axis=0) / h
    qd = np.zeros_like(q)
    before, after = slope[:-1], slope[1:]
    ha, hb = h[:-1], h[1:]
    first, second = 2.0 * hb + ha, hb + 2.0 * ha
    # Zero where the direction reverses: that point is an extremum. (By signs, since a product can underflow.)
    goes_on = np.sign(before) * np.sign(after) > 0.0
    before, after = np.where(goes_on, before, 1.0), np.where(goes_on, after, 1.0)
    # The weighted harmonic mean of the two slopes, with the lesser taken out so that nothing overflows.
    least = np.minimum(np.abs(before), np.abs(after))
    mean = least * (first + second) / (first * (least / np.abs(before)) + second * (least / np.abs(after)))
    qd[1:-1] = np.where(goes_on, np.sign(before) * mean, 0.0)
    return qd


def _coefficients(time: FloatArray, q: FloatArray, qd: FloatArray, qdd: FloatArray | None) -> FloatArray:
    """(segments, 6 powers of u, 6 joints), where u goes from 0 to 1 in each segment."""
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

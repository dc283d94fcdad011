"""Steps of a stream: polynomials from one point to the next, braking after the last point, and paths onto new points.

The program on the robot computes the same steps (`urlink.script.buffering`). Therefore this computer can calculate
where the arm brakes, without a report from the program. An `Aim` is a point that the arm should reach. The function
`onto` computes a path from the current curve onto another curve of points.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from dataclasses import dataclass
from functools import partial

import numpy as np

from linkcore.errors import BadValue
from linkcore.pending_call import Call, PendingCall, current_call

from ...arm.models import Model
from ...arm.vectors import FloatArray
from ...errors import LimitExceeded
from ...script.buffering import BRAKING_FACTOR, STRAY
from ..limited import LimitedArm
from ..moves.trajectory import refuse_beyond
from ..servo.jerk_limited import JointLimit

#: Fractions of the duration of a step at which the step is compared with limits (see `urlink.motion.moves.trajectory`).
_PLACES = np.linspace(0.0, 1.0, 17)
#: Fraction by which a value may exceed a limit, because of rounding.
_SLACK = 1e-6
#: Speed in rad/s and acceleration in rad/s² below which a joint counts as at rest.
_RESTING = 1e-6
#: Largest difference between a moment and the beginning of a step that begins in this moment, in rad, rad/s and rad/s².
_SAME = 1e-6
#: Factor between successive durations that are tried for a path back onto the points, and the longest duration
#: `_LONGEST` in s. Chosen: the path takes at most an eighth longer than necessary.
_LONGER, _LONGEST = 1.125, 20.0
#: Powers of the time that belong to the six coefficients of a polynomial.
_POWERS = np.arange(6.0)


@dataclass(frozen=True)
class JointMoment:
    """State of the joints at one time.

    It has positions in rad, speeds in rad/s and accelerations in rad/s², each of shape (6,).
    """

    q: FloatArray
    qd: FloatArray
    qdd: FloatArray

    @classmethod
    def at_rest(cls, q: Sequence[float] | FloatArray) -> JointMoment:
        """Return the moment of an arm at rest at `q`, (6,) rad."""
        return cls(np.array(q, dtype=np.float64), np.zeros(6), np.zeros(6))

    @property
    def rests(self) -> bool:
        """Whether no joint moves."""
        return bool(max(np.abs(self.qd).max(), np.abs(self.qdd).max()) < _RESTING)


class Step:
    """Motion from one moment to another: one polynomial for each joint.

    Args:
        rows: Coefficients, shape (6 powers, 6 joints). The variable is the time since the step began, in s.
        length: Duration in s.
        degree: Degree: 1, 3 or 5. A step of degree 4 is the first part of a cubic step (`urlink.script.buffering`).
    """

    __slots__ = ("degree", "length", "rows")

    def __init__(self, rows: FloatArray, length: float, degree: int = 5) -> None:
        self.rows = rows
        self.length = length
        self.degree = degree

    @classmethod
    def to(cls, begin: JointMoment, end: JointMoment, length: float, degree: int) -> Step:
        """Return the step from one moment to another.

        A step of degree 1 or 3 does not match all speeds and accelerations of the moments.

        Args:
            begin, end: The two moments.
            length: Duration in s.
            degree: Degree of the step.
        """
        rows = np.zeros((6, 6))
        h = length
        mean = (end.q - begin.q) / h
        rows[0] = begin.q
        if degree == 1:
            rows[1] = mean
        elif degree < 5:
            rows[1] = begin.qd
            rows[2] = (3.0 * mean - 2.0 * begin.qd - end.qd) / h
            rows[3] = (begin.qd + end.qd - 2.0 * mean) / h**2
        else:
            v0, v1, a0, a1 = begin.qd, end.qd, begin.qdd, end.qdd
            rows[1] = v0
            rows[2] = 0.5 * a0
            rows[3] = (10.0 * mean - 6.0 * v0 - 4.0 * v1 + h * (0.5 * a1 - 1.5 * a0)) / h**2
            rows[4] = (8.0 * v0 + 7.0 * v1 - 15.0 * mean + h * (1.5 * a0 - a1)) / h**3
            rows[5] = (6.0 * mean - 3.0 * v0 - 3.0 * v1 + 0.5 * h * (a1 - a0)) / h**4
        return cls(rows, length, degree)

    @classmethod
    def braking(cls, begin: JointMoment, limits: Sequence[JointLimit]) -> Step:
        """Return the step from a moment to rest.

        All joints take the same time. If the arm is already at rest, the length of the step is 0.

        See `urlink.script.buffering`.
        """
        length = 0.0
        for v, a, limit in zip(np.abs(begin.qd).tolist(), np.abs(begin.qdd).tolist(), limits, strict=True):
            by_jerk = (2.0 * a + math.sqrt(4.0 * a * a + 6.0 * limit.jerk * v)) / limit.jerk
            if a * by_jerk**2 > 12.0 * STRAY:
                by_jerk = max(math.sqrt(6.0 * v / limit.jerk), math.sqrt(12.0 * STRAY / a))
            length = max(length, BRAKING_FACTOR * v / limit.acceleration, by_jerk)
        rows = np.zeros((6, 6))
        rows[0] = begin.q
        if length > 0.0:
            v, a = begin.qd, begin.qdd
            rows[1:5] = v, 0.5 * a, -(v / length + 2.0 / 3.0 * a) / length, (0.5 * v / length + 0.25 * a) / length**2
        return cls(rows, length)

    def sampled(self, t: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return positions and speeds at the times `t`, (n,) s: arrays of shape (n, 6)."""
        return _derivatives(self.rows, t[:, np.newaxis] ** _POWERS)[:2]

    def at(self, t: float) -> JointMoment:
        """Return the moment `t` s after the beginning of the step."""
        return JointMoment(*_derivatives(self.rows, t**_POWERS))

    @property
    def begin(self) -> JointMoment:
        """Moment at the beginning of the step."""
        return self.at(0.0)

    @property
    def end(self) -> JointMoment:
        """Moment at the end of the step; its accelerations are 0 if the degree is 3."""
        end = self.at(self.length)
        return JointMoment(end.q, end.qd, np.zeros(6)) if self.degree == 3 else end

    def begins_in(self, moment: JointMoment) -> bool:
        """Whether the step begins in a moment.

        Only the quantities that the degree of the step can match are compared.
        """
        begin = self.begin
        return all(
            np.abs(getattr(begin, each) - getattr(moment, each)).max() < _SAME
            for each in ("q", "qd", "qdd")[: (self.degree + 1) // 2]
        )

    def cut(self, length: float) -> Step:
        """Return the first part of the step, with a duration of `length` seconds."""
        return Step(self.rows, length, 4 if self.degree == 3 else self.degree)

    def rest(self, t: float) -> Step:
        """Return the remaining part of the step after `t` seconds."""
        # The coefficients of the remaining part are those of the Taylor expansion around t.
        rows = np.array([sum(math.comb(k, n) * t ** (k - n) * self.rows[k] for k in range(n, 6)) for n in range(6)])
        return Step(rows, self.length - t, self.degree)


def _derivatives(rows: FloatArray, powers: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Calculate positions, speeds and accelerations from the coefficients and the powers of the time."""
    qd = (_POWERS[1:] * powers[..., :-1]) @ rows[..., 1:, :]
    qdd = (_POWERS[2:] * _POWERS[1:-1] * powers[..., :-2]) @ rows[..., 2:, :]
    return powers @ rows, qd, qdd


def _sampled(rows: FloatArray, lengths: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return positions, speeds, accelerations and jerks of n steps, each of shape (n, places, joints).

    The shape of `rows` is (n, 6, 6).
    """
    t = lengths[:, None] * _PLACES
    powers = t[..., None] ** _POWERS
    qddd = (_POWERS[3:] * _POWERS[2:-1] * _POWERS[1:-2] * powers[..., :-3]) @ rows[:, 3:]
    return *_derivatives(rows, powers), qddd


class Bounds:
    """Bounds for the steps of a stream.

    Args:
        model: Model of the arm; None if it is unknown. The limits of position and acceleration of the model apply to
            the points.
        speeds: Largest speeds of the joints, shape (6,), in rad/s.
        limits: Limits for the motions that the stream adds to the points: braking, and the paths back onto the points.
        limited: Function that returns the arm with the limits of the session; None if the session has no limits.
    """

    def __init__(
        self,
        model: Model | None,
        speeds: Sequence[float],
        limits: Sequence[JointLimit],
        limited: Callable[[], LimitedArm | None] = lambda: None,
    ) -> None:
        self._limited = limited
        self.limits = tuple(limits)
        self._arm = "the fastest arm" if model is None else f"a {model.name}"
        self._speeds = np.array(speeds)
        # A message can hold positions of up to three turns; larger positions are not supported (`buffering.FINE`).
        turns = np.tile([-6.0 * math.pi, 6.0 * math.pi], (6, 1))
        low, high = (turns if model is None else np.clip(model.position_limits, turns[:, :1], turns[:, 1:])).T
        self._low, self._high = low, high
        self._accelerations = np.full(6, 1000.0) if model is None else model.max_acceleration
        self._own = np.array([[limit.acceleration, limit.jerk] for limit in limits]).T

    def braked(self, moment: JointMoment) -> JointMoment:
        """Return the moment at rest after braking from `moment`."""
        return JointMoment.at_rest(Step.braking(moment, self.limits).end.q)

    def check(self, steps: Sequence[Step], names: Sequence[str]) -> None:
        """Raise an error if the arm cannot follow these steps, or would leave its range by braking after one of them.

        The jumps in speed between steps of degree 1 do not count as accelerations.

        Args:
            steps: The steps.
            names: Name of each step, used in error messages.

        Raises:
            BadValue: If a limit is exceeded. The message contains the step, the joint, the value and the limit.
        """
        rows = np.array([step.rows for step in steps])
        lengths = np.array([step.length for step in steps])
        q, qd, qdd, _ = _sampled(rows, lengths)
        refuse = partial(refuse_beyond, lambda step, place: names[step], self._arm)
        low, high = self._low, self._high
        refuse(q, "position", "rad", np.where(q < low, low, high), (q < low) | (q > high))
        for values, limit, what, unit in (
            (qd, self._speeds, "speed", "rad/s"),
            (qdd, self._accelerations, "acceleration", "rad/s²"),
        ):
            beyond = np.abs(values) > limit * (1.0 + _SLACK)
            refuse(values, what, unit, np.broadcast_to(limit, values.shape), beyond)
        rests = np.array([[self.braked(step.end).q] for step in steps])
        what = "position after braking, if no point followed,"
        refuse(rests, what, "rad", np.where(rests < low, low, high), (rests < low) | (rests > high))
        limited = self._limited()
        if limited is not None:
            self._check_limits(limited, steps, names)

    def _check_limits(self, limited: LimitedArm, steps: Sequence[Step], names: Sequence[str]) -> None:
        """Compare steps, and braking after the last one, with the limits of the session."""
        for step, name in zip(steps, names, strict=True):
            braking = Step.braking(step.end, self.limits)
            for each in (step, braking) if step is steps[-1] and braking.length > 0.0 else (step,):
                try:
                    limited.check_curve(each.sampled, np.array([0.0, each.length]))
                except LimitExceeded as error:
                    raise LimitExceeded(error.limit, f"{name}: {error.value}", error.expected) from None

    def way(self, begin: JointMoment, end: JointMoment, least: float) -> Step | None:
        """Return the quickest polynomial from one moment to another within the limits; None if there is none.

        The polynomial does not exceed the largest speeds of the joints. It also does not exceed the limits of
        acceleration and jerk for the motions that the stream adds. Exception: if an acceleration at the beginning or
        the end is higher than the limit, the whole polynomial may have this acceleration.

        Args:
            begin, end: The two moments.
            least: Shortest duration, in s.
        """
        count = max(math.ceil(math.log(_LONGEST / least, _LONGER)), 1) if least < _LONGEST else 1
        for first in range(0, count, 16):
            tried = [Step.to(begin, end, least * _LONGER**i, 5) for i in range(first, min(first + 16, count))]
            found = self.first_within(tried)
            if found is not None:
                return tried[found]
        return None

    def first_within(self, ways: Sequence[Step]) -> int | None:
        """Return the index of the first step within the limits for the motions that the stream adds, or None."""
        q, qd, qdd, qddd = _sampled(np.array([way.rows for way in ways]), np.array([way.length for way in ways]))
        hard, sharp = self._own
        # If the points at the ends of a path have accelerations above the limit, the path may have these accelerations,
        # too.
        hard = np.maximum(hard, np.maximum(np.abs(qdd[:, :1]), np.abs(qdd[:, -1:])))
        slack = 1.0 + _SLACK
        is_within = (
            ((q >= self._low) & (q <= self._high)).all((1, 2))
            & (np.abs(qd) <= self._speeds * slack).all((1, 2))
            & (np.abs(qdd) <= hard * slack).all((1, 2))
            & (np.abs(qddd) <= sharp * slack).all((1, 2))
        )
        limited = self._limited()
        for found in np.flatnonzero(is_within).tolist():
            if limited is None or self._is_limited(limited, ways[found]):
                return int(found)
        return None

    @staticmethod
    def _is_limited(limited: LimitedArm, way: Step) -> bool:
        """Whether a step is within the limits of the session."""
        try:
            limited.check_curve(way.sampled, np.array([0.0, way.length]))
        except LimitExceeded:
            return False
        return True


#: Factor between the successive durations that are tried for a path onto other points.
_LATER = 1.25


@dataclasses.dataclass(frozen=True)
class Mark:
    """End of all points of a stream: the time on the clock of the stream, in s, and the moment of the arm there."""

    time: float
    moment: JointMoment


class Handed:
    """Points that were appended together.

    Attributes:
        future: Future that gets its result when the last point has been sent, or an error if the points were dropped.
        call: Call of the task that appends these points; None if the caller is not a task.
    """

    def __init__(self) -> None:
        self.future: Future[None] = Future()
        self.call: Call | PendingCall | None = current_call()

    def settle(self, error: Exception | None = None) -> None:
        """Give the future its result, or an error."""
        if not self.future.done():
            if error is None:
                self.future.set_result(None)
            else:
                self.future.set_exception(error)


@dataclasses.dataclass(frozen=True)
class Aim:
    """A point that the arm should reach.

    Attributes:
        time: Time on the clock of the stream, in s.
        moment: Moment of the arm at the point.
        step: Step from the previous point; None if the arm is at rest at the point.
        handed: Points that were appended together with this one; None if this point was computed here.
    """

    time: float
    moment: JointMoment
    step: Step | None
    handed: Handed | None = None

    @property
    def degree(self) -> int:
        """Degree of the step to the point.

        The degree is 5 if there is no step, because all values of the moment are then given.
        """
        return 5 if self.step is None else self.step.degree


def onto(bounds: Bounds, curve: Sequence[Aim], here: JointMoment, time: float, shortest: float) -> list[Aim]:
    """Return the path from a moment of the current curve onto another curve, followed by the rest of the other curve.

    The path is as short as the limits allow.

    Args:
        bounds: Bounds of the stream.
        curve: Points of the other curve, each with the step from the previous point.
        here: Moment of the current curve at `time`.
        time: Time in s on the clock of the stream.
        shortest: Shortest duration of a step, in s.

    Raises:
        BadValue: If all points of the other curve are in the past, or if no path within the limits leads onto this
            curve.
    """
    places: list[tuple[Aim, list[Aim]]] = []
    at = max(time + 2.0 * shortest, curve[0].time)
    while at < curve[-1].time + (at - time) * (_LATER - 1.0) and len(places) < 40:
        place = _landing(curve, min(at, curve[-1].time), shortest)
        if not places or place[0].time > places[-1][0].time:
            places.append(place)
        at = time + _LATER * (at - time)
    if not places:
        raise BadValue(
            f"all points are in the past: the last is at {curve[-1].time:g} s, but points are needed from {time:g} s on"
        )
    ways = [Step.to(here, aim.moment, aim.time - time, 5) for aim, _ in places]
    found = bounds.first_within(ways)
    if found is None:
        raise BadValue(
            f"the points up to {curve[-1].time:g} s cannot be reached from the position of the stream at {time:g} s "
            "within the limits of acceleration and jerk of the stream; expected points that are closer, or later"
        )
    aim, rest = places[found]
    return [dataclasses.replace(aim, step=ways[found]), *rest]


def _landing(curve: Sequence[Aim], at: float, shortest: float) -> tuple[Aim, list[Aim]]:
    """Return the aim on a curve at the time `at`, and the points after this aim.

    If the next point of the curve is close to this time, this point is the aim.
    """
    following = next(i for i, aim in enumerate(curve) if aim.time >= at)
    aim = curve[following]
    if aim.step is None or aim.time - at < shortest:
        return aim, list(curve[following + 1 :])
    t = aim.step.length - (aim.time - at)
    rest = aim.step.rest(t)
    begin = Aim(at, rest.begin, None)
    return begin, [dataclasses.replace(aim, step=rest), *curve[following + 1 :]]

"""Resampling of targets or of a schedule to set-points, one for each cycle of the controller.

Each real-time state that arrives is answered with the next set-point. So the controller's clock sets the pace, even if
targets arrive irregularly. While set-points are missing, the program on the robot coasts
(`urlink.motion.servo.setpoints`). If the position after coasting is close to the next set-point of the source, which is
usual, the difference is faded out. Otherwise the source begins again from the position and the speed after coasting.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import AbstractContextManager
from typing import Protocol

import numpy as np

from linkcore.errors import BadValue

from ...arm.models import Model
from ...command.program_time import ProgramTimer
from ...protocol.realtime.packets import RealtimeState
from ...script.messages import WAIT_MESSAGE
from ..limited import LimitedArm, Prediction
from ..moves.trajectory import Trajectory
from .following import Rest
from .jerk_limited import JointLimit, TargetFilter
from .setpoints import Servoing, SetpointStream

#: Largest differences of any joint that are faded out, in position (rad) and in speed (rad/s). Chosen: at 1 rad/s, the
#: position differs this much after 20 ms without set-points, with the default watchdog.
_WIDEST_GAP, _LARGEST_CHANGE = 0.005, 0.2
#: Time constant for fading out a difference, in s: after this time, a third of the difference is left. Chosen: longer
#: than the usual gaps between set-points on a busy computer, so that a coasting program does not overshoot.
_SETTLING = 0.1


class ResampledSource(Protocol):
    """Source of set-points.

    Each `time` is the time of a state on the controller's clock. `rate` is the number of seconds that pass for the
    program per second of the controller.
    """

    @property
    def has_targets(self) -> bool:
        """Whether there is a target."""

    def begin(self, time: float, q: Sequence[float]) -> None:
        """Begin with the arm at rest at `q`, (6,) rad."""

    def skip(self, time: float, seconds: float) -> tuple[list[float], list[float]]:
        """Skip missed set-points.

        The program on the robot has coasted meanwhile: it has covered the distance of `seconds` at the last speed.

        Returns:
            Current positions, (6,) rad, and speeds, (6,) rad/s.
        """

    def restart(self, time: float, q: Sequence[float], qd: Sequence[float]) -> None:
        """Continue after coasting, from the positions `q`, (6,) rad, and the speeds `qd`, (6,) rad/s."""

    def at(self, time: float, rate: float) -> tuple[list[float], list[float]]:
        """Return the positions, (6,) rad, and speeds, (6,) rad/s, of the set-point that answers the state of `time`."""

    def accept(self, time: float, rate: float) -> None:
        """Record that the set-point for the state of `time` was sent."""


class ResampledSetpoints:
    """Part of a dialogue that answers each state with a set-point from a source.

    Args:
        servoing: Parameters for following set-points.
        source: Source of the set-points.
    """

    def __init__(self, servoing: Servoing, source: ResampledSource) -> None:
        self._source = source
        self._stream = SetpointStream(servoing)
        self._timer = ProgramTimer(self._stream.cycle)
        self._rest = Rest("the servo")
        self._has_begun = False
        #: difference between the last set-point that was sent and the set-point of the source, in rad
        self._gap = [0.0] * 6

    def resume(self, state: RealtimeState) -> None:
        """Continue after a pause, from the position of the arm."""
        self._timer.restart()
        if self._has_begun:
            here = state.q_target.tolist()
            self._stream.begin(here)
            self._source.restart(state.time, here, [0.0] * 6)
            self._gap = [0.0] * 6

    def answer(self, state: RealtimeState, now: float) -> bytes:
        """Return the message for the program on the robot, as the answer to a state.

        Raises:
            LinkTimeout: If the arm does not come to rest before the first set-point.
        """
        passed, scaled = self._timer.passed(state, now)
        if not self._has_begun:
            if not self._rest.is_reached(state, now) or not self._source.has_targets:
                return WAIT_MESSAGE
            self._has_begun = True
            here = state.q_target.tolist()
            self._source.begin(state.time, here)
            self._stream.begin(here)
            return self._stream.send(here, [0.0] * 6, now)
        self._stream.advance(passed, scaled)
        if not self._stream.is_due:
            return b""
        missed = self._stream.missed
        if missed:
            self._catch_up(missed, state.time, now)
        gap = [(1.0 - self._stream.cycle / _SETTLING) * each for each in self._gap]
        rate = self._timer.rate
        q, qd = self._source.at(state.time, rate)
        q = [a + b for a, b in zip(q, gap, strict=True)]
        if self._stream.excess(q, now) is not None:
            # The joints cannot move this far in the time that has passed on this computer. So nothing is sent, and the
            # robot coasts.
            return b""
        self._source.accept(state.time, rate)
        self._gap = gap
        return self._stream.send(q, [a - b / _SETTLING for a, b in zip(qd, gap, strict=True)], now)

    def _catch_up(self, missed: int, time: float, now: float) -> None:
        """Continue from the position of the arm after the program on the robot has coasted for `missed` cycles."""
        here, speeds = self._stream.coasted_to(missed)
        if self._stream.excess(here, now) is not None:
            # According to this computer's clock, this many cycles cannot have passed.
            return
        there, theirs = self._source.skip(time, self._stream.coasted_time(missed))
        self._gap = [a - b for a, b in zip(here, there, strict=True)]
        change = max(abs(a - b) for a, b in zip(speeds, theirs, strict=True))
        if max(map(abs, self._gap)) > _WIDEST_GAP or change > _LARGEST_CHANGE:
            self._gap = [0.0] * 6
            self._source.restart(time, here, speeds)


class FilteredTargets:
    """Source that calculates the set-points of a servo from the newest target of `Servo.send`.

    Args:
        limits: Limits of each joint.
        cycle: Cycle of the controller, in s.

    Attributes:
        newest: Newest target, shape (6,), in rad. The thread that calls `Servo.send` sets it.
    """

    def __init__(self, limits: Sequence[JointLimit], cycle: float) -> None:
        self.newest: list[float] | None = None
        self._limits, self._cycle = limits, cycle
        self._filter: TargetFilter  # set by `begin`, which is called first

    def predicted(self, target: Sequence[float], here: Sequence[float]) -> list[Prediction]:
        """Return predictions of the motion to a target: one for each cycle in which the target might be used.

        Args:
            target: The target, (6,) rad.
            here: Position of the arm at rest, (6,) rad. It is used before the first target.
        """
        now = getattr(self, "_filter", None)
        return [
            TargetFilter(here, self._limits).predicted(target, 0.0)
            if now is None
            else now.predicted(target, cycles * self._cycle)
            for cycles in range(3 if now is not None else 1)
        ]

    @property
    def has_targets(self) -> bool:
        return self.newest is not None

    def begin(self, time: float, q: Sequence[float]) -> None:
        self._filter = TargetFilter(q, self._limits)

    def skip(self, time: float, seconds: float) -> tuple[list[float], list[float]]:
        self._filter.advance(seconds)
        return list(self._filter.q), list(self._filter.qd)

    def restart(self, time: float, q: Sequence[float], qd: Sequence[float]) -> None:
        self._filter.restart(q, qd)

    def at(self, time: float, rate: float) -> tuple[list[float], list[float]]:
        assert self.newest is not None  # checked by `has_targets`
        self._filter.aim(self.newest)
        return self._filter.after(rate * self._cycle)

    def accept(self, time: float, rate: float) -> None:
        self._filter.advance(rate * self._cycle)


#: Shortest time between two waypoints, in s. Waypoints that are closer in time count as one waypoint.
_CLOSEST = 1e-3
#: Time in s for the rest of the path if the times of all waypoints have passed while set-points were missing.
_LATE = 0.1
#: Maximum number of postponements of new waypoints. Each postponement lengthens the time before the first new waypoint
#: by this fraction. In total, this time can grow to nearly 400 times its original length.
_PUT_OFF, _LATER = 16, 0.45

_Waypoint = tuple[float, list[float]]


class Schedule:
    """Source that calculates the set-points of a servo from waypoints with times on the robot's clock.

    A cubic curve in joint space begins at the current set-point with its speed, passes through all future waypoints,
    and ends at rest at the last waypoint. The speeds at the waypoints in between are chosen as for a `Trajectory`. Each
    new waypoint starts a new curve from the current set-point and its speed, so the speed never jumps.

    The rules are the same as in the interpolation controller of UMI, a program for learning from demonstrations. A
    waypoint replaces all waypoints with the same time or a later time. A waypoint is ignored if its time has passed. If
    a waypoint cannot be reached in time, it is postponed. If set-points were missed, so that the arm is not at its
    set-point, all future waypoints may be postponed. One difference: UMI's controller moves straight from pose to pose,
    with a jump in speed at each pose.

    Args:
        model: Model of the arm, for its limits; None if the model is unknown.
        cycle: Cycle of the controller, in s.
        delay: Time in s from a state until the arm reaches the set-point that answers this state.
        section: Lock of the robot. It is needed because waypoints and states arrive in different threads.
        limited: The arm with the limits of the session; None if the session has no limits.
    """

    def __init__(
        self,
        model: Model | None,
        cycle: float,
        delay: float,
        section: AbstractContextManager[object],
        limited: LimitedArm | None = None,
    ) -> None:
        self._limited = limited
        self._model = model
        self._cycle = cycle
        self._delay = delay
        self._section = section
        self._waypoints: list[_Waypoint] = []
        #: curve that begins at the time `_origin` on the robot's clock
        self._curve: Trajectory | None = None
        self._origin: float
        #: time of the last set-point; None before the first set-point
        self._now: float | None = None

    def add(self, q: list[float], at: float, time: float, here: Sequence[float]) -> float | None:
        """Add a waypoint: joint positions and a time on the robot's clock.

        Args:
            q: Joint positions of the waypoint, shape (6,), in rad.
            at: Time of the waypoint, in s.
            time: Time of the newest state, in s.
            here: Target positions of the arm, shape (6,), in rad. Used if the schedule has not begun.

        Returns:
            Time at which the arm will reach the waypoint: `at`, or later if the arm needs more time. None if the time
            `at` has passed.

        Raises:
            BadValue: If the curve leaves the range of a joint, or if urlink finds no curve that the arm can follow.
        """
        with self._section:
            anchor = self._now if self._now is not None else time + self._delay
            if at < anchor + self._cycle:
                return None
            waypoints = [each for each in self._waypoints if anchor + _CLOSEST < each[0] < at - _CLOSEST]
            q0, qd0 = self._sample(anchor) if self._now is not None else (list(here), [0.0] * 6)
            # A waypoint that is almost due is left out, because the new curve begins at almost the same point.
            self._plan(anchor, q0, qd0, [*waypoints, (at, q)], len(waypoints))
            return self._waypoints[-1][0]

    @property
    def last(self) -> list[float] | None:
        """Last waypoint, (6,) rad; None if there is none."""
        return self._waypoints[-1][1] if self._waypoints else None

    # -- the source of set-points --------------------------------------------------------------------

    @property
    def has_targets(self) -> bool:
        """Whether there is a waypoint."""
        return bool(self._waypoints)

    def begin(self, time: float, q: Sequence[float]) -> None:
        """Begin with the arm at rest at `q`."""
        self._set_out(time + self._delay, q, [0.0] * 6)

    def restart(self, time: float, q: Sequence[float], qd: Sequence[float]) -> None:
        """Continue from the positions `q` with the speeds `qd`."""
        self._set_out(time + self._delay - self._cycle, q, qd)

    def _set_out(self, anchor: float, q: Sequence[float], qd: Sequence[float]) -> None:
        with self._section:
            self._now = anchor
            ahead = [each for each in self._waypoints if each[0] > anchor + self._cycle]
            self._plan(anchor, q, qd, ahead or [(anchor + _LATE, self._waypoints[-1][1])], 0)

    def skip(self, time: float, seconds: float) -> tuple[list[float], list[float]]:
        """Return the current positions and speeds. The time of a schedule passes even if no set-points are sent."""
        with self._section:
            return self._sample(time + self._delay - self._cycle)

    def at(self, time: float, rate: float) -> tuple[list[float], list[float]]:
        """Return the set-point that answers the state of this time."""
        with self._section:
            return self._sample(time + self._delay)

    def accept(self, time: float, rate: float) -> None:
        """Record that the set-point for the state of `time` was sent."""
        self._now = time + self._delay

    # ------------------------------------------------------------------------------------------------

    def _sample(self, t: float) -> tuple[list[float], list[float]]:
        assert self._curve is not None
        q, qd, _ = self._curve.sample(t - self._origin)
        return q, qd

    def _plan(
        self, anchor: float, q: Sequence[float], qd: Sequence[float], waypoints: list[_Waypoint], new: int
    ) -> None:
        """Plan the curve from the current set-point through waypoints.

        If the arm cannot follow the curve, the waypoint with index `new` and all later waypoints are postponed.
        """
        times = [time for time, _ in waypoints]
        places = np.array([list(q), *(place for _, place in waypoints)])
        before = times[new - 1] if new else anchor
        put_off = 0
        while True:
            curve = _curve(np.array([0.0, *(time - anchor for time in times)]), places, qd)
            try:
                curve.check(self._model)
                break
            except BadValue:
                if put_off == _PUT_OFF:
                    raise
            put_off += 1
            later = _LATER * (times[new] - before)
            times[new:] = [time + later for time in times[new:]]
        if self._limited is not None:
            self._limited.check_curve(lambda t: curve.at(t)[:2], curve.time)
        self._waypoints = [(time, place) for time, (_, place) in zip(times, waypoints, strict=True)]
        self._curve, self._origin = curve, anchor


def _curve(times: np.ndarray, places: np.ndarray, qd: Sequence[float]) -> Trajectory:
    """Return a curve through positions at times. It begins with the speeds `qd` and ends at rest."""
    speeds = Trajectory.from_arrays(times, places).qd.copy()
    speeds[0] = qd
    return Trajectory.from_arrays(times, places, speeds)

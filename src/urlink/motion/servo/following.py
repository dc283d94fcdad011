"""Base of the two dialogues that follow a trajectory: the time on the trajectory, start, tolerances and end.

This module does no I/O and has no clock: `urlink.motion.servo.linked_program` passes the states and times.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from linkcore.arguments import check_number
from linkcore.errors import LinkTimeout

from ...arm.vectors import JOINTS, FloatArray
from ...command.program_time import ProgramTimer
from ...errors import ToleranceExceeded
from ...protocol.realtime.packets import RealtimeState
from ...script.links import Writer
from ..moves.trajectory import Trajectory
from ..slider import SliderEffect, slider
from .setpoints import LinkDialogue

#: Number of cycles from a state until the set-point for this state takes effect. The set-point is sent within the next
#: cycle, and the program applies it at the beginning of the cycle after that.
AHEAD = 2
#: Joint speed in rad/s below which the arm counts as at rest.
_STANDING = 0.02
#: Time in s within which the arm must come to rest before a trajectory begins.
_REST_TIMEOUT = 1.5
#: Times in s for finding the point of the trajectory that is closest to the arm after a pause: search range before the
#: time of the pause, search range after this time, and step of the search.
_BEFORE, _BRAKING, _NEARNESS = 0.2, 1.0, 0.004
#: Number of newest states for which the time on the trajectory is kept: two seconds at 500 Hz. They are needed for slow
#: feedback functions.
_REMEMBERED = 1024


@dataclass(frozen=True)
class TrajectoryFeedback:
    """Actual and desired position of the arm.

    Arrays have shape (6,), joints from base to wrist 3.

    Attributes:
        time: Time in seconds on the controller's clock since the trajectory began.
        trajectory_time: Time on the trajectory in seconds. It advances with the time of the program on the robot. So it
            is less than `time` if the speed slider was below 100 %, or if the program was paused.
        q_desired: Positions of the trajectory at `trajectory_time`, in rad.
        qd_desired: Velocities of the trajectory at `trajectory_time`, in rad/s.
        q_actual: Positions that the controller reports for this time, in rad.
        qd_actual: Velocities that the controller reports for this time, in rad/s.
        error: Difference `q_desired` - `q_actual`, in rad.
    """

    time: float
    trajectory_time: float
    q_desired: FloatArray
    qd_desired: FloatArray
    q_actual: FloatArray
    qd_actual: FloatArray
    error: FloatArray


@dataclass(frozen=True)
class Tolerances:
    """Largest allowed deviations of the arm from its trajectory.

    Attributes:
        path: Largest deviation of any joint before the end, in rad; None for no limit.
        goal: Largest deviation of any joint at the end, in rad.
        goal_time: Time after the end within which the arm must reach the goal, in seconds of the trajectory's time.
        start: Largest distance of any joint from the first point, in rad.
    """

    path: float | None
    goal: float
    goal_time: float
    start: float

    @classmethod
    def checked(
        cls, path_tolerance: float | None, goal_tolerance: float, goal_time: float, start_tolerance: float
    ) -> Tolerances:
        """Return the tolerances that a user passes, after checking their ranges.

        Raises:
            BadValue: If a tolerance is not a number, or is out of range.
        """
        return cls(
            None if path_tolerance is None else check_number(path_tolerance, "path_tolerance", 1e-6, 100.0),
            check_number(goal_tolerance, "goal_tolerance", 1e-6, 100.0),
            check_number(goal_time, "goal_time", 0.0, 3600.0),
            check_number(start_tolerance, "start_tolerance", 1e-6, 1.0),
        )


class Rest:
    """Monitor of an arm that must come to rest before a motion begins.

    Args:
        what: Motion that should begin, used in error messages.
    """

    def __init__(self, what: str) -> None:
        self._what = what
        self._moving_since: float | None = None

    def is_reached(self, state: RealtimeState, now: float) -> bool:
        """Whether the arm is at rest.

        Raises:
            LinkTimeout: If the arm does not come to rest in time.
        """
        if self._moving_since is None:
            self._moving_since = now
        is_standing = stands(state.qd_target)
        if not is_standing and now - self._moving_since > _REST_TIMEOUT:
            raise LinkTimeout(f"the arm did not come to rest within {_REST_TIMEOUT:g} s, so {self._what} did not begin")
        return is_standing


@slider(follow=SliderEffect.SCALED)
class Following(LinkDialogue):
    """Base class of the two dialogues that follow a trajectory.

    The time of a trajectory advances with the time of the program on the robot (`urlink.command.program_time`).

    Args:
        write: Function that returns the lines of the program.
        trajectory: Trajectory to follow.
        tolerances: Largest allowed deviations.
        timer: Timer of the trajectory.

    Attributes:
        progress: Fraction of the trajectory that has passed.
        is_over: Whether the arm has arrived and is at rest. The motion ends later, after the event BRAKE.
    """

    def __init__(self, write: Writer, trajectory: Trajectory, tolerances: Tolerances, timer: ProgramTimer) -> None:
        super().__init__(write)
        self.progress = 0.0
        #: end of the motion, in s on the trajectory; after the end of the trajectory if an offset must still be faded
        #: out
        self._end = trajectory.duration
        self._trajectory = trajectory
        self._tolerances = tolerances
        self._timer = timer
        #: time in s since the trajectory began, on the controller's clock; set by the first comparison
        self._passed: float
        #: for each state: time of the state, time since the trajectory began, and time on the trajectory, in s
        self._times: deque[tuple[float, float, float]] = deque(maxlen=_REMEMBERED)
        #: time of the next point that the program has not yet passed, in s on the trajectory; infinite if the program
        #: does not report its points
        self._next_time = math.inf
        self._rest = Rest("the trajectory")

    def resume(self, state: RealtimeState) -> None:
        """Continue after a pause, from the position of the arm."""
        self._timer.restart()

    def _nearest(self, q: Sequence[float], t: float) -> float:
        """Return the time of the trajectory's point that is closest to `q`, (6,) rad, after a pause at `t`, in s.

        The search includes times after `t`, because the controller braked along the path, and times before `t`, because
        the arm was behind its set-points.
        """
        times = np.clip(np.arange(t - _BEFORE, t + _BRAKING, _NEARNESS), min(t, 0.0), self._trajectory.duration)
        places = np.array([self._trajectory.sample(each)[0] for each in times.tolist()])
        return float(times[np.square(places - q).sum(1).argmin()])

    def times(self, time: float) -> tuple[float, float] | None:
        """Return the time since the beginning and the time on the trajectory, in s, for a state with the time `time`.

        Return None before the trajectory has begun, or if the state is older than the kept states. This method may be
        called from any thread.
        """
        after = None
        for n in range(1, len(self._times) + 1):
            at, passed, t = self._times[-n]
            if at <= time:
                if after is None:
                    return passed + time - at, min(t + self._timer.rate * (time - at), max(t, self._next_time))
                share = (time - at) / (after[0] - at)
                return passed + time - at, t + share * (after[2] - t)
            after = at, passed, t
        return None

    def desired(self, t: float) -> tuple[list[float], list[float]]:
        """Return the desired positions, (6,) rad, and velocities, (6,) rad/s, at the time `t` on the trajectory."""
        q, qd, _ = self._trajectory.sample(t)
        return q, qd

    def _check_start(self, state: RealtimeState) -> list[float]:
        """Return the target joint positions of the arm, and check that they are close to the first point.

        Raises:
            BadValue: If these positions are not close to the first point.
        """
        q = state.q_target.tolist()
        self._trajectory.check(near=q, within=self._tolerances.start)
        return list(q)

    def _compare(self, state: RealtimeState, t: float) -> None:
        """Compare the arm with the trajectory at the time `t`.

        Raises:
            ToleranceExceeded: If the arm is too far from the trajectory.
        """
        trajectory, tolerances = self._trajectory, self._tolerances
        if not self._times:
            self._passed = t
        if state.time == state.time:  # is false for NaN
            self._times.append((state.time, self._passed, t))
        self.progress = t / trajectory.duration
        actual = state.q_actual.tolist()
        if t < self._end:
            if tolerances.path is not None:
                _refuse(self.desired(t)[0], actual, tolerances.path, f"{t:.3f} s into its path")
            return
        goal = trajectory.q[-1].tolist()
        is_there = all(abs(g - a) <= tolerances.goal for g, a in zip(goal, actual, strict=True))
        if is_there and stands(state.qd_actual):
            self.is_over = True
        elif t > self._end + tolerances.goal_time:
            _refuse(goal, actual, tolerances.goal, f"{tolerances.goal_time:g} s after the end of its path")
            self.is_over = True


def _refuse(desired: Sequence[float], actual: Sequence[float], tolerance: float, when: str) -> None:
    errors = [abs(d - a) for d, a in zip(desired, actual, strict=True)]
    worst = max(range(6), key=lambda joint: errors[joint] if errors[joint] == errors[joint] else float("inf"))
    if not errors[worst] <= tolerance:  # is also true for NaN
        raise ToleranceExceeded(
            f"{JOINTS[worst]} (joint {worst}) is {errors[worst]:.4f} rad from the desired position, {when}; "
            f"the tolerance is {tolerance:g} rad"
        )


def stands(speeds: FloatArray) -> bool:
    """Whether an arm with these joint speeds, (6,) rad/s, is at rest."""
    return all(abs(speed) < _STANDING for speed in speeds.tolist())

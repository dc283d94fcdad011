"""The common part of both ways to follow a trajectory: the controller's clock, the start, the tolerances, the end.

Sans-IO and without a clock: `urlink.motion.linked` passes states and times in.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass

from linkcore.errors import LinkTimeout

from ..errors import ToleranceExceeded
from ..interfaces.realtime.packets import RealtimeState
from ..urscript.links import InputRegisters, ReverseSocket
from ..vectors import JOINTS, FloatArray
from .trajectory import Trajectory

__all__ = ["AHEAD", "ControllerClock", "Following", "Rest", "Tolerances", "TrajectoryFeedback"]

#: Cycles from a state to the one in which its set-point takes effect: it is sent within the next cycle, and the program
#: applies it at the beginning of the one after.
AHEAD = 2
#: rad/s below which an arm counts as standing still.
_STANDING = 0.02
#: Seconds that an arm has to come to rest before a trajectory begins.
_REST_TIMEOUT = 1.5
#: Seconds by which a state may be quicker than the quickest before it. If it is more, a clock was set.
_EARLIER = 0.1


@dataclass(frozen=True)
class TrajectoryFeedback:
    """Where the arm is, and where its trajectory is. Arrays are (6,), joints from base to wrist 3.

    Attributes:
        time: seconds on the controller's clock since the trajectory began.
        q_desired: rad; what the trajectory says for this time.
        qd_desired: rad/s.
        q_actual: rad; what the controller reports for this time.
        qd_actual: rad/s.
        error: rad, `q_desired` - `q_actual`.
    """

    time: float
    q_desired: FloatArray
    qd_desired: FloatArray
    q_actual: FloatArray
    qd_actual: FloatArray
    error: FloatArray


@dataclass(frozen=True)
class Tolerances:
    """How far the arm may be from its trajectory.

    Attributes:
        path: rad, in any joint, on the way; None for no limit.
        goal: rad, in any joint, at the end.
        goal_time: seconds after the end within which it has to arrive.
        start: rad, in any joint, between the arm and the first point.
    """

    path: float | None
    goal: float
    goal_time: float
    start: float


class ControllerClock:
    """Measures how much time passes on the controller, by the times in its states, as far as these are plausible.

    A state cannot come before its time. How long states take to arrive is not known, but the quickest of them gives a
    bound: a state that would be quicker by more than `_EARLIER` has a wrong time. So states that were delayed, or are
    read late, may come together, and the time of each counts. This also holds for a simulated controller that was
    delayed and catches up faster than time passes.

    For a state with no time, or one in the past or too far in the future, this computer's clock counts, with one cycle
    at least. The states after it are compared with it.

    Args:
        cycle: seconds of the controller's cycle.
    """

    def __init__(self, cycle: float) -> None:
        self._cycle = cycle
        self._last: tuple[float, float] | None = None
        #: s from the time of a state to its arrival, each on its own clock: of the quickest; from the first state on
        self._quickest: float

    def passed(self, time: float, now: float) -> float:
        """Seconds since the last state; 0 for the first.

        Args:
            time: of the state, on the controller's clock.
            now: its arrival, monotonic s.
        """
        last, self._last = self._last, (time, now)
        way = now - time
        if last is None:
            self._quickest = way
            return 0.0
        told = time - last[0]
        if told >= 0.0 and way >= self._quickest - _EARLIER:
            self._quickest = min(self._quickest, way)
            return told
        self._quickest = way
        return max(now - last[1], self._cycle)


class Rest:
    """Waits until the arm stands still, so that a motion can begin.

    Args:
        what: the motion that is to begin, for messages.
    """

    def __init__(self, what: str) -> None:
        self._what = what
        self._moving_since: float | None = None

    def is_reached(self, state: RealtimeState, now: float) -> bool:
        """Whether the arm stands still.

        Raises:
            LinkTimeout: it does not come to rest.
        """
        if self._moving_since is None:
            self._moving_since = now
        is_standing = stands(state.qd_target)
        if not is_standing and now - self._moving_since > _REST_TIMEOUT:
            raise LinkTimeout(f"the arm did not come to rest within {_REST_TIMEOUT:g} s, so {self._what} did not begin")
        return is_standing


class Following(ABC):
    """A trajectory that is being followed: the base of the two `Dialogue`s that do it.

    Args:
        trajectory: what to follow.
        tolerances: how closely.
        cycle: seconds of the controller's cycle.

    Attributes:
        farewell: the word that ends the program.
        survives_its_program: whether the motion goes on if the program ends before the arm has arrived.
        progress: the fraction that is over.
        is_over: whether the arm has arrived and stands still.
        began: by the time of states, s: when the trajectory began, or would have had to begin for the arm to be led now
            to where it is led; None before it began.
    """

    def __init__(self, trajectory: Trajectory, tolerances: Tolerances, cycle: float) -> None:
        self.farewell = b""
        self.survives_its_program = False
        self.progress = 0.0
        self.is_over = False
        self.began: float | None = None
        self._trajectory = trajectory
        self._tolerances = tolerances
        self._clock = ControllerClock(cycle)
        self._rest = Rest("the trajectory")

    @abstractmethod
    def body(self, link: ReverseSocket | InputRegisters) -> list[str]:
        """The lines of the program on the robot."""

    @abstractmethod
    def step(self, received: bytes, state: RealtimeState, now: float) -> bytes:
        """The word that answers a state."""

    def conclude(self) -> None:  # noqa: B027 -- only one of them has something left to do then
        """Handle that the program has ended by itself."""

    def desired(self, t: float) -> tuple[list[float], list[float]]:
        """Positions, rad, and velocities, rad/s, that the arm should have at a time."""
        q, qd, _ = self._trajectory.sample(t)
        return q, qd

    def _check_start(self, state: RealtimeState) -> list[float]:
        """The target joint positions of the arm, which must be close to the first point.

        Raises:
            BadValue: they are not.
        """
        q = state.q_target.tolist()
        self._trajectory.check(near=q, within=self._tolerances.start)
        return list(q)

    def _compare(self, state: RealtimeState, t: float) -> None:
        """Compare the arm with the trajectory at the time `t`.

        Raises:
            ToleranceExceeded: the arm is too far away.
        """
        trajectory, tolerances = self._trajectory, self._tolerances
        self.began = state.time - t
        self.progress = t / trajectory.duration
        actual = state.q_actual.tolist()
        if t < trajectory.duration:
            if tolerances.path is not None:
                _refuse(self.desired(t)[0], actual, tolerances.path, f"{t:.3f} s into its path")
            return
        goal = trajectory.q[-1].tolist()
        is_there = all(abs(g - a) <= tolerances.goal for g, a in zip(goal, actual, strict=True))
        if is_there and stands(state.qd_actual):
            self.is_over = True
        elif t > trajectory.duration + tolerances.goal_time:
            _refuse(goal, actual, tolerances.goal, f"{tolerances.goal_time:g} s after the end of its path")
            self.is_over = True


def _refuse(desired: Sequence[float], actual: Sequence[float], tolerance: float, when: str) -> None:
    errors = [abs(d - a) for d, a in zip(desired, actual, strict=True)]
    worst = max(range(6), key=lambda joint: errors[joint] if errors[joint] == errors[joint] else float("inf"))
    if not errors[worst] <= tolerance:  # true for NaN too
        raise ToleranceExceeded(
            f"{JOINTS[worst]} (joint {worst}) is {errors[worst]:.4f} rad from where it should be, {when}; "
            f"the tolerance is {tolerance:g} rad"
        )


def stands(speeds: FloatArray) -> bool:
    """Whether an arm with these joint speeds, (6,) rad/s, stands still."""
    return all(abs(speed) < _STANDING for speed in speeds.tolist())

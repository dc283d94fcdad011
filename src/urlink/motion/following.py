"""The common part of both ways to follow a trajectory: the controller's clock, the beginning, the tolerances, the end.

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

#: Cycles from a state to that in which the set-point that it brings about takes effect: it is sent back within the next
#: one, and the program takes it up at the beginning of the one after.
AHEAD = 2
#: rad/s below which an arm stands.
_STANDING = 0.02
#: Seconds that an arm has to come to rest before a trajectory begins.
_REST_TIMEOUT = 1.5
#: Seconds by which a state may come earlier than the quickest before it. More than that means that a clock was set.
_EARLIER = 0.1


@dataclass(frozen=True)
class TrajectoryFeedback:
    """Where the arm is on its trajectory. Arrays are (6,), joints from base to wrist 3.

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
    """How far the arm may be from where it should be.

    Attributes:
        path: rad, in any joint, on the way; None for no limit.
        goal: rad, in any joint, at the end.
        goal_time: seconds after the end within which it has to arrive.
        start: rad, in any joint, from the first point.
    """

    path: float | None
    goal: float
    goal_time: float
    start: float


class ControllerClock:
    """How much time passes on the controller, by the plausible times of its states.

    A state cannot come before its time. How long states are on their way is not known, but the quickest of them gives
    a bound: one that would be quicker than that by more than `_EARLIER` has a wrong time. So states that were held up
    on their way, or read late, may come together, and the time of each counts; also where a simulated controller that
    was held up makes up for it faster than time passes.

    For a state without a time, from the past, or from such a future, this computer's clock counts, and one cycle at
    least; the states after it are held against it.

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
            now: when it came, on a clock of this computer that only grows.
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
    """Waits for the arm to stand, so that something can begin.

    Args:
        what: the motion that is to begin, for messages.
    """

    def __init__(self, what: str) -> None:
        self._what = what
        self._moving_since: float | None = None

    def is_reached(self, state: RealtimeState, now: float) -> bool:
        """Whether the arm stands.

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
    """A trajectory that is being followed: what both `Dialogue`s of `urlink.motion.linked` share.

    Args:
        trajectory: what to follow.
        tolerances: how closely.
        cycle: seconds of the controller's cycle.

    Attributes:
        farewell: the word that ends the program.
        survives_its_program: the motion goes on where the program ends before the arm has arrived.
        progress: the part of it that is over.
        is_over: the arm has arrived, and stands.
        began: on the clock of the states: when the arm was at the beginning, or would have been, to be at this moment
            where it is led; None before that.
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
        """What to say when a state has come."""

    def conclude(self) -> None:  # noqa: B027 -- only one of them has something left to do then
        """The program has come to its own end."""

    def desired(self, t: float) -> tuple[list[float], list[float]]:
        """Positions and velocities that the arm is to have at a time."""
        q, qd, _ = self._trajectory.sample(t)
        return q, qd

    def _check_start(self, state: RealtimeState) -> list[float]:
        """Where the arm's targets are, which is near the first point.

        Raises:
            BadValue: it is not.
        """
        q = state.q_target.tolist()
        self._trajectory.check(near=q, within=self._tolerances.start)
        return list(q)

    def _compare(self, state: RealtimeState, t: float) -> None:
        """Hold the arm against where it should be at the time `t` of the trajectory.

        Raises:
            ToleranceExceeded: it is too far away.
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
    if not errors[worst] <= tolerance:  # so that NaN is too far as well
        raise ToleranceExceeded(
            f"{JOINTS[worst]} (joint {worst}) is {errors[worst]:.4f} rad from where it should be, {when}; "
            f"the tolerance is {tolerance:g} rad"
        )


def stands(speeds: FloatArray) -> bool:
    """Whether an arm with these speeds of its joints stands, (6,) rad/s."""
    return all(abs(speed) < _STANDING for speed in speeds.tolist())

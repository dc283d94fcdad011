"""What both ways to follow a trajectory have in common: its beginning, its tolerances, its feedback, its end."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from linkcore.errors import LinkTimeout

from ..errors import ToleranceExceeded
from ..interfaces.realtime.packets import RealtimeState
from ..vectors import JOINTS, FloatArray
from .equipment import Equipment
from .linked import LinkedMotion
from .reverse import ReverseLink
from .trajectory import Trajectory

__all__ = ["Following", "Tolerances", "TrajectoryFeedback"]

#: rad/s below which an arm stands.
_STANDING = 0.02
#: Seconds that an arm has to come to rest before a trajectory begins.
_REST_TIMEOUT = 1.5


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
        path: rad, in any joint, on the way; None for any distance.
        goal: rad, in any joint, at the end.
        goal_time: seconds after the end within which it has to arrive.
        start: rad, in any joint, from the first point.
    """

    path: float | None
    goal: float
    goal_time: float
    start: float


class Following(LinkedMotion):
    """A trajectory that is being followed."""

    def __init__(
        self,
        equipment: Equipment,
        trajectory: Trajectory,
        tolerances: Tolerances,
        feedback: Callable[[TrajectoryFeedback], object] | None,
    ) -> None:
        super().__init__("follow", equipment)
        self._trajectory = trajectory
        self._tolerances = tolerances
        self._feedback = feedback
        #: s on the controller's clock at which the trajectory began
        self._t0: float | None = None
        self._resting_since: float | None = None
        self._reached = 0.0

    def _desired(self, t: float) -> tuple[list[float], list[float]]:
        """Positions and velocities that the arm is to have at a time."""
        q, qd, _ = self._trajectory.sample(t)
        return q, qd

    def _begin(self) -> None:
        super()._begin()
        if self._feedback is not None:
            # On a queue and a thread of its own: it may be slow, and it may raise.
            self._attend(self._equipment.realtime.subscribe(self._tell))

    def _tell(self, state: RealtimeState) -> None:
        t0 = self._t0
        if t0 is None or self._feedback is None or self.done or state.time < t0:
            return
        t = state.time - t0
        q, qd = map(np.array, self._desired(t))
        self._feedback(TrajectoryFeedback(t, q, qd, state.q_actual, state.qd_actual, q - state.q_actual))

    def _rests(self, state: RealtimeState) -> bool:
        """Whether the arm stands, so that a trajectory can begin.

        Raises:
            LinkTimeout: it does not come to rest.
        """
        now = time.monotonic()
        if self._resting_since is None:
            self._resting_since = now
        if max(map(abs, state.qd_target.tolist())) < _STANDING:
            return True
        if now - self._resting_since > _REST_TIMEOUT:
            raise LinkTimeout(
                f"the arm did not come to rest within {_REST_TIMEOUT:g} s, so the trajectory did not begin"
            )
        return False

    def _check_start(self, state: RealtimeState) -> list[float]:
        """Where the arm's targets are, which is near the first point.

        Raises:
            BadValue: it is not.
        """
        q = state.q_target.tolist()
        self._trajectory.check(near=q, within=self._tolerances.start)
        return list(q)

    def _follow_up(self, state: RealtimeState, desired: Sequence[float]) -> bool:
        """Whether the arm has arrived, and stands.

        Raises:
            ToleranceExceeded: it is too far away.
        """
        assert self._t0 is not None
        trajectory, tolerances = self._trajectory, self._tolerances
        t = state.time - self._t0
        self._reached = t / trajectory.duration
        actual = state.q_actual.tolist()
        if t < trajectory.duration:
            if tolerances.path is not None:
                self._refuse(desired, actual, tolerances.path, f"{t:.3f} s into its path")
            return False
        goal = trajectory.q[-1].tolist()
        is_there = max(abs(g - a) for g, a in zip(goal, actual, strict=True)) <= tolerances.goal
        if is_there and max(map(abs, state.qd_actual.tolist())) < _STANDING:
            return True
        if t > trajectory.duration + tolerances.goal_time:
            self._refuse(goal, actual, tolerances.goal, f"{tolerances.goal_time:g} s after the end of its path")
            return True
        return False

    def _refuse(self, desired: Sequence[float], actual: Sequence[float], tolerance: float, when: str) -> None:
        errors = [abs(d - a) for d, a in zip(desired, actual, strict=True)]
        error = max(errors)
        if error > tolerance:
            joint = errors.index(error)
            raise ToleranceExceeded(
                f"{JOINTS[joint]} (joint {joint}) is {error:.4f} rad from where it should be, {when}; "
                f"the tolerance is {tolerance:g} rad"
            )

    def _measure(self) -> float:
        return self._reached

    def _step(self, link: ReverseLink, state: RealtimeState) -> None:
        raise NotImplementedError

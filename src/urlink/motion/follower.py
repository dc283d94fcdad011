"""A trajectory as a stream of set-points, one per cycle of the controller.

Each real-time state that arrives is answered with the set-point for its own time, a little ahead: the controller's
clock paces the stream, so it does not matter how this computer's clock runs, and a state that comes late only makes its
set-point late. What arrives while this computer was held up is not made up for: the next set-point is for the newest
state.
"""

from __future__ import annotations

from collections.abc import Callable

from ..interfaces.realtime.packets import RealtimeState
from .equipment import Equipment
from .following import Following, Tolerances, TrajectoryFeedback
from .reverse import ReverseLink
from .setpoints import STOP_WORD, WAIT_WORD, Servoing, setpoint
from .trajectory import Trajectory

__all__ = ["Follower"]

#: Cycles from a state to that in which the set-point that it brings about takes effect: it is sent back within the next
#: one, and the program takes it up at the beginning of the one after.
_AHEAD = 2
#: rad/s at most with which the arm is led from where it stands to the trajectory.
_FADE_SPEED = 0.25
#: Seconds that this takes at least.
_FADE_LEAST = 0.2


class Follower(Following):
    """Streams a trajectory.

    Where the arm does not stand exactly at the first point, the difference is faded out while it moves.

    Args:
        servoing: how its set-points are followed.
    """

    def __init__(
        self,
        equipment: Equipment,
        trajectory: Trajectory,
        tolerances: Tolerances,
        feedback: Callable[[TrajectoryFeedback], object] | None,
        servoing: Servoing,
    ) -> None:
        super().__init__(equipment, trajectory, tolerances, feedback)
        self._servoing = servoing
        self._ahead = _AHEAD / equipment.firmware.rate
        self._offset = [0.0] * 6
        self._fade = _FADE_LEAST

    def _body(self, host: str, port: int) -> list[str]:
        return self._servoing.body(self._equipment.firmware, host, port)

    def _farewell(self) -> bytes:
        return STOP_WORD

    def _desired(self, t: float) -> tuple[list[float], list[float]]:
        q, qd, _ = self._trajectory.sample(t)
        u = t / self._fade
        if u < 1.0:
            rest = 1.0 - max(u, 0.0)
            share = rest * rest * (3.0 - 2.0 * rest)
            speed = -6.0 * rest * (1.0 - rest) / self._fade
            q = [each + share * offset for each, offset in zip(q, self._offset, strict=True)]
            qd = [each + speed * offset for each, offset in zip(qd, self._offset, strict=True)]
        return q, qd

    def _step(self, link: ReverseLink, state: RealtimeState) -> None:
        link.received()  # it sends nothing, but this shows that it is there
        if self._t0 is None:
            if not self._rests(state):
                self._say(WAIT_WORD)
                return
            here = self._check_start(state)
            self._offset = [q - first for q, first in zip(here, self._trajectory.q[0].tolist(), strict=True)]
            self._fade = max(1.5 * max(map(abs, self._offset)) / _FADE_SPEED, _FADE_LEAST)
            self._t0 = state.time
        t = state.time - self._t0
        # First of all: everything else can wait until it is on its way.
        self._say(setpoint(self._desired(t + self._ahead)[0]))
        if self._follow_up(state, self._desired(t)[0]):
            self._conclude()

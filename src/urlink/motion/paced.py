"""Set-points that are made here, one for each cycle of the controller: of a target filter, or of a schedule.

Each real-time state that arrives is answered with the next set-point, so the controller's clock is the pace, whenever
the targets come. While set-points stay away, the program on the robot goes on at the speed that came with the last one,
ever slower. How far that is, is known here. What lies between that place and the one that the set-points have come to
by themselves is small, as a rule, and is faded out; otherwise what makes them begins anew from there, with the speed
that is left.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from ..interfaces.realtime.packets import RealtimeState
from ..models import Model
from .following import ControllerClock, Rest
from .setpoints import WAIT_WORD, Servoing, setpoint
from .speed_limit import SpeedLimit

__all__ = ["PacedSetpoints", "SetpointSource"]

#: rad and rad/s, in any joint, above which a gap is not faded out. Chosen: at 1 rad/s that is what 20 ms of a hold-up
#: make with the usual watchdog.
_WIDEST_GAP, _LARGEST_CHANGE = 0.005, 0.2
#: s over which a gap is closed: after this time a third of it is left. Chosen: longer than set-points stay away on a
#: busy computer, so that a program that goes on by itself does not run past.
_SETTLING = 0.1


class SetpointSource(Protocol):
    """What makes the set-points. Times are those of states, on the controller's clock."""

    @property
    def has_targets(self) -> bool:
        """There is somewhere to go to."""

    def begin(self, time: float, q: Sequence[float]) -> None:
        """The arm rests at `q` (6, rad)."""

    def skip(self, time: float, seconds: float) -> tuple[list[float], list[float]]:
        """Set-points stayed away, while the robot went on for so many seconds by itself.

        Returns:
            where they are by now (6, rad), and how fast (6, rad/s).
        """

    def restart(self, time: float, q: Sequence[float], qd: Sequence[float]) -> None:
        """Go on from `q` (6, rad), at speeds `qd` (6, rad/s), where the arm is led by now."""

    def at(self, time: float) -> tuple[list[float], list[float]]:
        """The set-point that answers the state of this time: (6,) rad, and (6,) rad/s."""

    def accept(self, time: float) -> None:
        """It is sent."""


class PacedSetpoints:
    """Answers states with set-points.

    Args:
        servoing: how they are followed.
        model: the arm; None if it is not known.
        source: what makes them.
    """

    def __init__(self, servoing: Servoing, model: Model | None, source: SetpointSource) -> None:
        self._servoing = servoing
        self._cycle = 1.0 / servoing.firmware.rate
        self._source = source
        self._limit = SpeedLimit(model, self._cycle, late=servoing.late)
        self._clock = ControllerClock(self._cycle)
        self._rest = Rest("the servo")
        self._has_begun = False
        #: s since the last set-point, by the controller's clock
        self._since = 0.0
        #: the last set-point, rad; and the speed with which the program on the robot goes on, rad/s
        self._q: list[float] = []
        self._qd = [0.0] * 6
        #: rad, between what is sent and what the source says
        self._gap = [0.0] * 6

    def answer(self, state: RealtimeState, now: float) -> bytes:
        """What to say to the program on the robot.

        Raises:
            LinkTimeout: the arm does not come to rest before the first set-point.
        """
        passed = self._clock.passed(state.time, now)
        if not self._has_begun:
            if not self._rest.is_reached(state, now) or not self._source.has_targets:
                return WAIT_WORD
            self._has_begun = True
            self._q = state.q_target.tolist()
            self._source.begin(state.time, self._q)
            self._limit.take(self._q, self._q, now)
            return setpoint(self._q, self._qd)
        self._since += passed
        if self._since < 0.5 * self._cycle:
            return b""
        missed = max(round(self._since / self._cycle) - 1, 0)
        if missed:
            self._catch_up(missed, state.time, now)
        gap = [(1.0 - self._cycle / _SETTLING) * each for each in self._gap]
        q, qd = self._source.at(state.time)
        q = [a + b for a, b in zip(q, gap, strict=True)]
        if self._limit.excess(self._q, q, now) is not None:
            # More than the joints can do in the time that has passed here: the robot goes on by itself.
            return b""
        self._source.accept(state.time)
        self._limit.take(self._q, q, now)
        self._q, self._gap, self._since = q, gap, 0.0
        self._qd = [a - b / _SETTLING for a, b in zip(qd, gap, strict=True)]
        return setpoint(q, self._qd)

    def _catch_up(self, missed: int, time: float, now: float) -> None:
        """The program on the robot went on by itself for so many cycles."""
        seconds, share = self._servoing.coasting(missed) * self._cycle, self._servoing.share(missed)
        here = [a + seconds * b for a, b in zip(self._q, self._qd, strict=True)]
        if self._limit.excess(self._q, here, now) is not None:
            # So many cycles cannot have passed, by this computer's clock.
            return
        speeds = [share * each for each in self._qd]
        there, theirs = self._source.skip(time, seconds)
        self._gap = [a - b for a, b in zip(here, there, strict=True)]
        change = max(abs(a - b) for a, b in zip(speeds, theirs, strict=True))
        if max(map(abs, self._gap)) > _WIDEST_GAP or change > _LARGEST_CHANGE:
            self._gap = [0.0] * 6
            self._source.restart(time, here, speeds)

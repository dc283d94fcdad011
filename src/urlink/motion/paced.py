"""Set-points of a target filter or of a schedule, one for each cycle of the controller.

Each real-time state that arrives is answered with the next set-point, so the controller's clock is the pace, whenever
the targets come. While set-points stay away, the program on the robot coasts (`urlink.motion.setpoint_stream`). The
difference between the place that it has coasted to and the next set-point of the source is small, as a rule, and is
faded out; where it is not, the source begins anew from that place, with the speed that is left.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from ..interfaces.realtime.packets import RealtimeState
from ..models import Model
from .following import ControllerClock, Rest
from .setpoint_stream import SetpointStream
from .setpoints import WAIT_WORD, Servoing

__all__ = ["PacedSetpoints", "SetpointSource"]

#: rad and rad/s, in any joint, above which a gap is not faded out. Chosen: at 1 rad/s that is what 20 ms of a hold-up
#: make with the usual watchdog.
_WIDEST_GAP, _LARGEST_CHANGE = 0.005, 0.2
#: s over which a gap is closed: after this time a third of it is left. Chosen: longer than set-points stay away on a
#: busy computer, so that a program that goes on by itself does not run past.
_SETTLING = 0.1


class SetpointSource(Protocol):
    """A source of set-points. Times are those of states, on the controller's clock."""

    @property
    def has_targets(self) -> bool:
        """There is a target."""

    def begin(self, time: float, q: Sequence[float]) -> None:
        """The arm rests at `q` (6, rad)."""

    def skip(self, time: float, seconds: float) -> tuple[list[float], list[float]]:
        """Set-points were missed, while the program on the robot coasted for so many seconds.

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
        servoing: how set-points are followed.
        model: the arm; None if it is not known.
        source: makes them.
    """

    def __init__(self, servoing: Servoing, model: Model | None, source: SetpointSource) -> None:
        self._source = source
        self._stream = SetpointStream(servoing, model)
        self._clock = ControllerClock(self._stream.cycle)
        self._rest = Rest("the servo")
        self._has_begun = False
        #: rad, between the last set-point and that of the source
        self._gap = [0.0] * 6

    def answer(self, state: RealtimeState, now: float) -> bytes:
        """The word for the program on the robot.

        Raises:
            LinkTimeout: the arm does not come to rest before the first set-point.
        """
        passed = self._clock.passed(state.time, now)
        if not self._has_begun:
            if not self._rest.is_reached(state, now) or not self._source.has_targets:
                return WAIT_WORD
            self._has_begun = True
            here = state.q_target.tolist()
            self._source.begin(state.time, here)
            self._stream.begin(here)
            return self._stream.send(here, [0.0] * 6, now)
        self._stream.advance(passed)
        if not self._stream.is_due:
            return b""
        missed = self._stream.missed
        if missed:
            self._catch_up(missed, state.time, now)
        gap = [(1.0 - self._stream.cycle / _SETTLING) * each for each in self._gap]
        q, qd = self._source.at(state.time)
        q = [a + b for a, b in zip(q, gap, strict=True)]
        if self._stream.excess(q, now) is not None:
            # More than the joints can do in the time that has passed here: the robot goes on by itself.
            return b""
        self._source.accept(state.time)
        self._gap = gap
        return self._stream.send(q, [a - b / _SETTLING for a, b in zip(qd, gap, strict=True)], now)

    def _catch_up(self, missed: int, time: float, now: float) -> None:
        """The program on the robot coasted for so many cycles."""
        here, speeds = self._stream.coasted_to(missed)
        if self._stream.excess(here, now) is not None:
            # So many cycles cannot have passed, by this computer's clock.
            return
        there, theirs = self._source.skip(time, self._stream.coasted_time(missed))
        self._gap = [a - b for a, b in zip(here, there, strict=True)]
        change = max(abs(a - b) for a, b in zip(speeds, theirs, strict=True))
        if max(map(abs, self._gap)) > _WIDEST_GAP or change > _LARGEST_CHANGE:
            self._gap = [0.0] * 6
            self._source.restart(time, here, speeds)

"""Set-points of a target filter or of a schedule, one for each cycle of the controller.

Each real-time state that arrives is answered with the next set-point, so the controller's clock sets the pace, whenever
targets come. While set-points are missed, the program on the robot coasts (`urlink.motion.setpoints`). Usually the
position that it has coasted to is close to the next set-point of the source, and the difference is faded out; if it is
not, the source begins again from that position, with the speed that is left.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from ..interfaces.realtime.packets import RealtimeState
from ..models import Model
from .controller_clock import ProgramClock
from .following import Rest
from .jerk_limited import JointLimit, TargetFilter
from .setpoints import WAIT_MESSAGE, Servoing, SetpointStream

#: rad and rad/s, in any joint; a larger gap is not faded out. Chosen: at 1 rad/s it is the gap after 20 ms without
#: set-points, with the default watchdog.
_WIDEST_GAP, _LARGEST_CHANGE = 0.005, 0.2
#: Time constant, s, of closing a gap: after this time a third of it is left. Chosen: longer than set-points are missed
#: on a busy computer, so that a program that coasts does not overshoot.
_SETTLING = 0.1


class PacedSource(Protocol):
    """A source of set-points. Times are those of states, on the controller's clock; `rate` is that of the program."""

    @property
    def has_targets(self) -> bool:
        """Whether there is a target."""

    def begin(self, time: float, q: Sequence[float]) -> None:
        """The arm rests at `q` (6, rad)."""

    def skip(self, time: float, seconds: float) -> tuple[list[float], list[float]]:
        """Set-points were missed, and the program on the robot coasted for `seconds`.

        Returns:
            the present positions, (6,) rad, and speeds, (6,) rad/s.
        """

    def restart(self, time: float, q: Sequence[float], qd: Sequence[float]) -> None:
        """Go on from `q`, (6,) rad, at speeds `qd`, (6,) rad/s, which the program has now after coasting."""

    def at(self, time: float, rate: float) -> tuple[list[float], list[float]]:
        """The set-point that answers the state of this time: (6,) rad, and (6,) rad/s."""

    def accept(self, time: float, rate: float) -> None:
        """The set-point of this time was sent."""


class PacedSetpoints:
    """Answers states with set-points.

    Args:
        servoing: how set-points are followed.
        model: the arm; None if it is not known.
        source: makes the set-points.
    """

    def __init__(self, servoing: Servoing, model: Model | None, source: PacedSource) -> None:
        self._source = source
        self._stream = SetpointStream(servoing, model)
        self._clock = ProgramClock(self._stream.cycle)
        self._rest = Rest("the servo")
        self._has_begun = False
        #: rad, between the last set-point and that of the source
        self._gap = [0.0] * 6

    def resume(self, state: RealtimeState) -> None:
        """Go on after a pause, from where the arm stands."""
        self._clock.restart()
        if self._has_begun:
            here = state.q_target.tolist()
            self._stream.begin(here)
            self._source.restart(state.time, here, [0.0] * 6)
            self._gap = [0.0] * 6

    def answer(self, state: RealtimeState, now: float) -> bytes:
        """The message for the program on the robot.

        Raises:
            LinkTimeout: the arm does not come to rest before the first set-point.
        """
        passed, scaled = self._clock.passed(state, now)
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
        rate = self._clock.rate
        q, qd = self._source.at(state.time, rate)
        q = [a + b for a, b in zip(q, gap, strict=True)]
        if self._stream.excess(q, now) is not None:
            # Further than the joints can move in the time that has passed here: nothing is sent, and the robot coasts.
            return b""
        self._source.accept(state.time, rate)
        self._gap = gap
        return self._stream.send(q, [a - b / _SETTLING for a, b in zip(qd, gap, strict=True)], now)

    def _catch_up(self, missed: int, time: float, now: float) -> None:
        """Handle that the program on the robot coasted for `missed` cycles."""
        here, speeds = self._stream.coasted_to(missed)
        if self._stream.excess(here, now) is not None:
            # By this computer's clock, so many cycles cannot have passed.
            return
        there, theirs = self._source.skip(time, self._stream.coasted_time(missed))
        self._gap = [a - b for a, b in zip(here, there, strict=True)]
        change = max(abs(a - b) for a, b in zip(speeds, theirs, strict=True))
        if max(map(abs, self._gap)) > _WIDEST_GAP or change > _LARGEST_CHANGE:
            self._gap = [0.0] * 6
            self._source.restart(time, here, speeds)


class FilteredTargets:
    """Makes the set-points of a servo from the last target of `Servo.send`.

    Args:
        limits: of each joint.
        cycle: s of the controller's cycle.

    Attributes:
        newest: the last target, (6,) rad; set by the thread that calls `Servo.send`.
    """

    def __init__(self, limits: Sequence[JointLimit], cycle: float) -> None:
        self.newest: list[float] | None = None
        self._limits, self._cycle = limits, cycle
        self._filter: TargetFilter  # made by `begin`, which comes first

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
        assert self.newest is not None  # `has_targets`
        self._filter.aim(self.newest)
        return self._filter.after(rate * self._cycle)

    def accept(self, time: float, rate: float) -> None:
        self._filter.advance(rate * self._cycle)

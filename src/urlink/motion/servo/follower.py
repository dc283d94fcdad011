"""A trajectory as a stream of set-points, one per cycle of the controller.

Each real-time state that arrives is answered with the set-point for its own time, a little ahead: the controller's
clock paces the stream, so it does not matter how this computer's clock runs. On the trajectory passes the time of the
program on the robot (`urlink.command.program_time`): where the speed slider, or what else scales motion, slows that
down, the set-points are closer together, and the program follows those that it has time for, on the same path.

The distance between two set-points is bounded, also after set-points were missed. While none arrives, the program on
the robot coasts: it goes on at the speed that came with the last one, ever slower (`urlink.script.streaming`). The
follower computes where the arm has coasted to, goes on from there, fades out the difference to the trajectory, and
follows the trajectory a tenth faster until it has caught up. Each set-point is checked against the speeds of the joints
(`urlink.motion.moves.speed_limit`): missed cycles that a state reports count only if this computer's clock has seen
them pass too. Where no set-point within the limit leads on, the motion ends with an error. As a last bound, the program
on the robot approaches no set-point faster than the joints can move.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence

from ...command.program_time import ProgramTimer
from ...errors import ToleranceExceeded
from ...protocol.realtime.packets import RealtimeState
from ..links.messages import WAIT_MESSAGE
from ..moves.trajectory import Trajectory
from .following import AHEAD, Following, Tolerances
from .setpoints import Servoing, SetpointStream

#: rad/s, at most, of the correction from the position of the arm to the trajectory.
_FADE_SPEED = 0.25
#: Seconds, at least, that this correction takes.
_FADE_LEAST = 0.2
#: Factor by which a trajectory may be followed faster to catch up. Chosen: one second makes up for 0.1 s, and the jump
#: in speed is no larger than those between the points of a coarse trajectory.
_CATCHING_UP = 1.1
#: Seconds, at least, in which the difference to the trajectory is closed, in place and in time. Chosen: those for which
#: the program coasts (`urlink.script.streaming.COASTING`), so that it does not overshoot.
_SETTLING = 0.1


class _Offset(ABC):
    """A difference between two positions of the arm, which shrinks as the trajectory goes on.

    Args:
        offset: (6,) rad, at first.
        begin: s on the trajectory.
        seconds: until nothing is left of it.

    Attributes:
        seconds: as given.
    """

    def __init__(self, offset: Sequence[float], begin: float, seconds: float) -> None:
        self._offset = list(offset)
        self._begin = begin
        self.seconds = seconds

    def at(self, t: float) -> tuple[list[float], list[float]]:
        """The rest of it at a time, rad, and how fast that changes, rad/s."""
        share, speed = self._left(1.0 - min(max((t - self._begin) / self.seconds, 0.0), 1.0))
        return [share * each for each in self._offset], [speed / self.seconds * each for each in self._offset]

    @abstractmethod
    def _left(self, rest: float) -> tuple[float, float]:
        """The share that is left at a share `rest` of the time, and how fast it changes in the whole time."""


class _Fade(_Offset):
    """A difference that is faded out, with speed zero at the beginning and the end."""

    def __init__(self, offset: Sequence[float], begin: float) -> None:
        super().__init__(offset, begin, max(1.5 * max(map(abs, offset)) / _FADE_SPEED, _FADE_LEAST))

    def _left(self, rest: float) -> tuple[float, float]:
        return rest * rest * (3.0 - 2.0 * rest), -6.0 * rest * (1.0 - rest)


class _Gap(_Offset):
    """A difference that is closed at constant speed, which works even if it is measured again in each cycle."""

    def __init__(self, offset: Sequence[float], begin: float) -> None:
        super().__init__(offset, begin, max(max(map(abs, offset)) / _FADE_SPEED, _SETTLING))

    def _left(self, rest: float) -> tuple[float, float]:
        return rest, -1.0 if rest > 0.0 else 0.0


class Follower(Following):
    """The set-points of a trajectory.

    If the arm does not stand exactly at the first point, the difference is faded out while it moves.

    Args:
        servoing: how its set-points are followed.
        delay: s from a state to the one in which the arm is at the set-point that answered it; None for the cycles that
            a set-point takes to arrive. What exceeds these is the lag of ``servoj``, which lasts longer while motion is
            scaled down (a guess: docs/protocols/urscript.md, Speed scaling).
        timer: of the trajectory; None for that of the program.
    """

    def __init__(
        self,
        trajectory: Trajectory,
        tolerances: Tolerances,
        servoing: Servoing,
        delay: float | None = None,
        timer: ProgramTimer | None = None,
    ) -> None:
        self._stream = SetpointStream(servoing)
        self._cycle = self._stream.cycle
        super().__init__(servoing.body, trajectory, tolerances, timer or ProgramTimer(self._cycle))
        self.watchdog = servoing.watchdog
        self._lag = 0.0 if delay is None else delay - AHEAD * self._cycle
        #: s that have passed on the trajectory; None before it began
        self._t: float | None = None
        # What there is once it has begun:
        #: between the arm and the first point, or its path after a pause; and between the arm and the trajectory, after
        #: set-points were missed
        self._start: _Fade
        self._gap: _Gap
        #: s: the time of the last set-point on the trajectory; and those on it with which the program goes on in one of
        #: its own
        self._s: float
        self._pace: float

    def desired(self, t: float) -> tuple[list[float], list[float]]:
        """Positions, rad, and velocities, rad/s, that the arm should have at a time."""
        q, qd = super().desired(t)
        offset, speed = self._start.at(t)
        return _sum(q, offset), _sum(qd, speed)

    def resume(self, state: RealtimeState) -> None:
        """Go on after a pause, from where the arm stands: from the nearest point of the trajectory."""
        super().resume(state)
        if self._t is not None:
            here = state.q_target.tolist()
            self._t = self._s = s = self._nearest(here, self._s)
            self._start = _Fade(_difference(here, super().desired(s)[0]), s)
            self._end = max(self._trajectory.duration, s + self._start.seconds)
            self._gap, self._pace = _Gap([0.0] * 6, s), 1.0
            self._stream.begin(here)

    def step(self, received: bytes, state: RealtimeState, now: float) -> bytes:
        """The message that answers a state; a second state of the same cycle is not answered.

        Raises:
            BadValue: the arm is not at the beginning of the trajectory.
            LinkTimeout: the arm does not come to rest.
            ToleranceExceeded: the arm is too far from the trajectory, or no set-point leads back to it within the
                limits.
        """
        passed, scaled = self._timer.passed(state, now)
        cycle = self._timer.rate * self._cycle
        if self._t is None:
            beginning = self._timer.beginning() if self._rest.is_reached(state, now) else None
            if beginning is None:
                return WAIT_MESSAGE
            here = self._check_start(state)
            self._start = _Fade(_difference(here, self._trajectory.q[0].tolist()), 0.0)
            self._stream.begin(here)
            # One that begins late is where one would be that had begun in time, and missed the set-points since then.
            late = max(round(beginning / self._cycle) - 1, 0)
            begun = min(beginning, cycle + self._stream.coasted_time(late))
            self._t, self._s, self._pace = beginning, begun + (AHEAD - 1) * cycle, 1.0
            self._gap = _Gap(_difference(here, self.desired(self._s)[0]) if late else [0.0] * 6, self._s)
        else:
            self._t = self._timer.after(self._t, scaled)
            self._passed += passed
            self._stream.advance(passed, scaled)
            if not self._stream.is_due:
                return b""
        message = self._next(self._t + AHEAD * cycle, cycle, now)
        self._compare(state, self._s - AHEAD * cycle - self._lag)
        return message

    def _next(self, wanted: float, cycle: float, now: float) -> bytes:
        """The next set-point: for the time `wanted` on the trajectory, or as close to it as the limits allow.

        Args:
            cycle: s that pass on the trajectory in a cycle of the controller.
        """
        excess = None
        # If this computer's clock shows that so many cycles cannot have passed, none was missed.
        for missed in (self._stream.missed, 0):
            here, _ = self._stream.coasted_to(missed)
            s = self._s + self._pace * self._stream.coasted_time(missed)
            gap = self._gap
            if missed:
                gap = _Gap(_difference(here, self.desired(s)[0]), s)
            most = min(max(wanted - s, 0.0), _CATCHING_UP * cycle)
            for ahead in (most, min(most, cycle), 0.5 * min(most, cycle), 0.0):
                q = _sum(self.desired(s + ahead)[0], gap.at(s + ahead)[0])
                excess = self._stream.excess(q, now)
                if excess is None:
                    self._gap = gap
                    return self._lead(q, s + ahead, wanted, now)
        raise ToleranceExceeded(f"the arm would have to leap to go on with its trajectory: {excess}")

    def _lead(self, q: list[float], s: float, wanted: float, now: float) -> bytes:
        """Send a set-point, and the speed at which the program goes on from it: along the trajectory, a little faster
        or slower, towards `wanted`."""
        most = _CATCHING_UP - 1.0
        self._s, self._pace = s, 1.0 + min(max((wanted - s) / _SETTLING, -most), most)
        closing = self._gap.at(s)[1]
        qd = [self._pace * along + across for along, across in zip(self.desired(s)[1], closing, strict=True)]
        return self._stream.send(q, qd, now)


def _sum(a: Sequence[float], b: Sequence[float]) -> list[float]:
    return [x + y for x, y in zip(a, b, strict=True)]


def _difference(a: Sequence[float], b: Sequence[float]) -> list[float]:
    return [x - y for x, y in zip(a, b, strict=True)]

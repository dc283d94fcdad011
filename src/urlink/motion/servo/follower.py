"""A trajectory as a stream of set-points, one per cycle of the controller.

Each real-time state that arrives is answered with the set-point for a time shortly after the state. The controller's
clock sets the pace of the stream, so the clock of this computer does not matter. The trajectory advances with the time
of the program on the robot (`urlink.command.program_time`). If the speed slider or another scaling slows down this
time, the set-points are closer together, and the arm moves more slowly on the same path.

The distance between two set-points is bounded, even after set-points were missed. While no set-point arrives, the
program on the robot coasts: it continues at the speed of the last set-point and slows down steadily
(`urlink.script.streaming`). The follower computes how far the arm has coasted, and continues from this position. It
fades out the difference to the trajectory, and follows the trajectory up to 10 % faster until it has caught up.

Each set-point is checked against the speeds of the joints (`urlink.motion.moves.speed_limit`). If a state reports
missed cycles, they count only if this time has also passed on this computer's clock. If no set-point within the limit
can continue the motion, the motion ends with an error. As a last protection, the program on the robot never moves to a
set-point faster than the joints can move.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence

from ...command.program_time import ProgramTimer
from ...errors import ToleranceExceeded
from ...protocol.realtime.packets import RealtimeState
from ...script.messages import WAIT_MESSAGE
from ..moves.trajectory import Trajectory
from .following import AHEAD, Following, Tolerances
from .setpoints import Servoing, SetpointStream

#: Largest joint speed of a correction from the position of the arm to the trajectory, in rad/s.
_FADE_SPEED = 0.25
#: Shortest duration of this correction, in s.
_FADE_LEAST = 0.2
#: Largest factor by which a trajectory is followed faster to catch up. Chosen: in one second, the arm catches up by 0.1
#: s. The jump in speed is not larger than the jumps between the points of a coarse trajectory.
_CATCHING_UP = 1.1
#: Shortest time in s in which a difference to the trajectory is closed, in position and in time. Chosen: as long as the
#: program coasts (`urlink.script.streaming.COASTING`), so that a coasting program does not overshoot.
_SETTLING = 0.1


class _Offset(ABC):
    """Difference between two positions of the arm. It decreases to zero while the trajectory advances.

    Args:
        offset: Difference at the beginning, shape (6,), in rad.
        begin: Time at which the difference begins to decrease, in s on the trajectory.
        seconds: Time until the difference is zero, in s.

    Attributes:
        seconds: Time until the difference is zero, in s.
    """

    def __init__(self, offset: Sequence[float], begin: float, seconds: float) -> None:
        self._offset = list(offset)
        self._begin = begin
        self.seconds = seconds

    def at(self, t: float) -> tuple[list[float], list[float]]:
        """Return the remaining difference at a time, in rad, and its rate of change, in rad/s."""
        share, speed = self._left(1.0 - min(max((t - self._begin) / self.seconds, 0.0), 1.0))
        return [share * each for each in self._offset], [speed / self.seconds * each for each in self._offset]

    @abstractmethod
    def _left(self, rest: float) -> tuple[float, float]:
        """Return the fraction of the difference that is left if a fraction `rest` of the time is left.

        Also return the derivative of the fraction with respect to the elapsed fraction of the time.
        """


class _Fade(_Offset):
    """Difference that decreases smoothly, with zero speed at the beginning and at the end."""

    def __init__(self, offset: Sequence[float], begin: float) -> None:
        super().__init__(offset, begin, max(1.5 * max(map(abs, offset)) / _FADE_SPEED, _FADE_LEAST))

    def _left(self, rest: float) -> tuple[float, float]:
        return rest * rest * (3.0 - 2.0 * rest), -6.0 * rest * (1.0 - rest)


class _Gap(_Offset):
    """Difference that decreases at constant speed. It may be measured again in each cycle."""

    def __init__(self, offset: Sequence[float], begin: float) -> None:
        super().__init__(offset, begin, max(max(map(abs, offset)) / _FADE_SPEED, _SETTLING))

    def _left(self, rest: float) -> tuple[float, float]:
        return rest, -1.0 if rest > 0.0 else 0.0


class Follower(Following):
    """Dialogue that sends a trajectory as a stream of set-points.

    If the arm is not exactly at the first point, the difference is faded out while the arm moves.

    Args:
        servoing: Parameters for following set-points.
        delay: Time in s from a state until the arm reaches the set-point that answered this state. If None, the delay
            is only the number of cycles that a set-point needs to arrive. The real delay also includes the lag of
            ``servoj``. This lag is longer while the speed scaling is below 100 % (assumed: docs/protocols/urscript.md,
            Speed scaling).
        timer: Timer of the trajectory. If None, the trajectory follows the time of the program.
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
        #: time in s that has passed on the trajectory; None before the trajectory has begun
        self._t: float | None = None
        # The following attributes are set when the trajectory begins.
        #: difference between the arm and the first point, or after a pause between the arm and the path
        self._start: _Fade
        #: difference between the arm and the trajectory after set-points were missed
        self._gap: _Gap
        #: time of the last set-point, in s on the trajectory
        self._s: float
        #: seconds that pass on the trajectory per second of the program
        self._pace: float

    def desired(self, t: float) -> tuple[list[float], list[float]]:
        """Return the desired positions, (6,) rad, and velocities, (6,) rad/s, at the time `t` on the trajectory."""
        q, qd = super().desired(t)
        offset, speed = self._start.at(t)
        return _sum(q, offset), _sum(qd, speed)

    def resume(self, state: RealtimeState) -> None:
        """Continue after a pause, from the position of the arm, at the nearest point of the trajectory."""
        super().resume(state)
        if self._t is not None:
            here = state.q_target.tolist()
            self._t = self._s = s = self._nearest(here, self._s)
            self._start = _Fade(_difference(here, super().desired(s)[0]), s)
            self._end = max(self._trajectory.duration, s + self._start.seconds)
            self._gap, self._pace = _Gap([0.0] * 6, s), 1.0
            self._stream.begin(here)

    def step(self, received: bytes, state: RealtimeState, now: float) -> bytes:
        """Return the message that answers a state; a second state of the same cycle is not answered.

        Raises:
            BadValue: If the arm is not at the beginning of the trajectory.
            LinkTimeout: If the arm does not come to rest.
            ToleranceExceeded: If the arm is too far from the trajectory, or if no set-point within the limits can
                continue the motion.
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
            # If the beginning is late, treat it like a beginning in time after which set-points were missed.
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
        """Return the set-point for the time `wanted` on the trajectory, or as close to this time as the limits allow.

        Args:
            wanted: Time of the set-point, in s on the trajectory.
            cycle: Time that passes on the trajectory in one cycle of the controller, in s.
            now: Monotonic time, in s.
        """
        excess = None
        # If the missed cycles cannot have passed according to this computer's clock, assume that no cycle was missed.
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
        raise ToleranceExceeded(f"the arm would have to jump to continue its trajectory: {excess}")

    def _lead(self, q: list[float], s: float, wanted: float, now: float) -> bytes:
        """Return the message with a set-point and the speed at which the program continues from it.

        This speed is the speed of the trajectory, increased or reduced by up to 10 % to approach the time `wanted`. The
        speed that closes the current difference is added.
        """
        most = _CATCHING_UP - 1.0
        self._s, self._pace = s, 1.0 + min(max((wanted - s) / _SETTLING, -most), most)
        closing = self._gap.at(s)[1]
        qd = [self._pace * along + across for along, across in zip(self.desired(s)[1], closing, strict=True)]
        return self._stream.send(q, qd, now)


def _sum(a: Sequence[float], b: Sequence[float]) -> list[float]:
    return [x + y for x, y in zip(a, b, strict=True)]


def _difference(a: Sequence[float], b: Sequence[float]) -> list[float]:
    return [x - y for x, y in zip(a, b, strict=True)]

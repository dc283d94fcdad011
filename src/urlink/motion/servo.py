"""Closed loops: set-points as the user's own loop makes them."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from linkcore.errors import BadValue

from ..interfaces.realtime.packets import RealtimeState
from ..urscript.programs import InputRegisters, ReverseSocket
from ..vectors import JOINTS, six
from .context import MotionContext
from .jerk_limited import JointLimit, TargetFilter
from .linked import Link
from .linked_block import LinkedBlock
from .paced import PacedSetpoints
from .setpoints import STOP_WORD, WAIT_WORD, Servoing, setpoint
from .speed_limit import SpeedLimit

__all__ = ["FilteredTargets", "Servo", "ServoStatistics"]

#: Intervals that the statistics look back on: a minute and a half at 500 Hz.
_REMEMBERED = 50_000
#: rad that the first set-point may be away from where the arm is led.
_NEAR = 0.05


@dataclass(frozen=True)
class ServoStatistics:
    """How evenly set-points, or targets, were sent.

    Attributes:
        count: how many were sent.
        mean: s between two of them.
        p50, p99, max: s, of the deviations of that from the period: half of them, 99 % of them and all are no larger.
        late: intervals longer than one and a half periods.
    """

    count: int
    mean: float
    p50: float
    p99: float
    max: float
    late: int


class FilteredTargets:
    """What `Servo.send` was told last, on its way through a target filter.

    Args:
        limits: of each joint.
        cycle: s of the controller's cycle.

    Attributes:
        newest: (6,) rad; set by whichever thread sends.
    """

    def __init__(self, limits: Sequence[JointLimit], cycle: float) -> None:
        self.newest: list[float] | None = None
        self._limits, self._cycle = limits, cycle
        self._filter = TargetFilter([0.0] * 6, limits)

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

    def at(self, time: float) -> tuple[list[float], list[float]]:
        if self.newest is not None:
            self._filter.aim(self.newest)
        return self._filter.after(self._cycle)

    def accept(self, time: float) -> None:
        self._filter.advance(self._cycle)


class _Leading:
    """What is said to the streaming program when a state has come: the next set-point, where they are made here.

    Before the first one, and for a loop that sends its own, only that somebody is there.

    Args:
        servoing: how set-points are followed.
        paced: makes them; None for a loop that sends its own.
    """

    farewell = STOP_WORD
    is_over = False
    survives_its_program = False

    def __init__(self, servoing: Servoing, paced: PacedSetpoints | None) -> None:
        self._servoing = servoing
        self._paced = paced
        #: rad; where the arm is led
        self.here: list[float] | None = None
        self.has_begun = False

    def body(self, link: ReverseSocket | InputRegisters) -> list[str]:
        return self._servoing.body(link)

    def step(self, received: bytes, state: RealtimeState, now: float) -> bytes:
        if self._paced is not None:
            return self._paced.answer(state, now)
        if self.has_begun:
            return b""
        self.here = state.q_target.tolist()
        return WAIT_WORD

    def conclude(self) -> None: ...


class Servo(LinkedBlock):
    """A loop's line to the joints; made by `robot.motion.servo`, and open within a ``with`` block.

    Send a set-point in each of the controller's cycles, or in each of your own; with a target filter, a target whenever
    there is one. Leaving the block stops the arm.

    Attributes:
        rate: set-points or targets a second that are meant to be sent.
    """

    def __init__(
        self,
        context: MotionContext,
        rate: float,
        servoing: Servoing,
        open_link: Callable[[], Link],
        limits: Sequence[JointLimit] | None = None,
    ) -> None:
        model = context.who.identity.arm
        cycle = 1.0 / servoing.firmware.rate
        self._targets = None if limits is None else FilteredTargets(limits, cycle)
        self._dialogue = _Leading(
            servoing, None if self._targets is None else PacedSetpoints(servoing, model, self._targets)
        )
        super().__init__(context, "servo", self._dialogue, open_link)
        self.rate = rate
        self._last: list[float] | None = None
        self._sent_at = 0.0
        self._count = self._late = 0
        self._began = 0.0
        self._intervals: deque[float] = deque(maxlen=_REMEMBERED)
        self._ranges = [(-math.inf, math.inf)] * 6 if model is None else model.position_limits.tolist()
        self._limit = SpeedLimit(model, 1.0 / rate)
        self._cycle = cycle

    def send(self, q: ArrayLike) -> None:
        """Send one set-point; with a target filter, a target.

        Args:
            q: (6,) joint positions, rad. With a target filter, anywhere within the limits of the arm. Without one, the
                first is no further than 0.05 rad from where the arm is; after that no joint is led faster than it can
                move; what is refused, and how uneven a loop may be, says `urlink.motion.speed_limit`.

        Raises:
            BadValue: not six finite numbers, too fast, or beyond a limit of the arm; nothing was sent.
            SafetyStop, NotRunning, ConnectionLost, ProgramStopped, Cancelled: it is over.
            LocalError: not within the block.
        """
        self._check_open()
        now = self._context.clock()
        values = self._in_range(q)
        if self._targets is not None:
            self._targets.newest = values
        else:
            self._check_step(values, now)
            self._say(setpoint(values, self._speeds(values, now)))
            self._limit.take(self._last or values, values, now)
        self._count_one(values, now)

    def _count_one(self, values: list[float], now: float) -> None:
        if self._last is None:
            self._dialogue.has_begun = True
            self._began = now
        else:
            interval = now - self._sent_at
            self._intervals.append(interval)
            if interval * self.rate > 1.5:
                self._late += 1
        self._count += 1
        self._last, self._sent_at = values, now

    @property
    def stats(self) -> ServoStatistics:
        """How evenly set-points, or targets, were sent; deviations are of the last 50000 intervals."""
        intervals = np.array(self._intervals)
        if not intervals.size:
            return ServoStatistics(self._count, 0.0, 0.0, 0.0, 0.0, self._late)
        deviations = np.abs(intervals - 1.0 / self.rate)
        p50, p99 = np.percentile(deviations, (50, 99)).tolist()
        mean = (self._sent_at - self._began) / (self._count - 1)
        return ServoStatistics(self._count, mean, p50, p99, float(deviations.max()), self._late)

    def _speeds(self, values: list[float], now: float) -> list[float]:
        """(6,) rad/s since the last set-point: with these the program goes on where the next one is late."""
        if self._last is None:
            return [0.0] * 6
        # Two that are sent at once are for two cycles all the same.
        seconds = max(now - self._sent_at, self._cycle)
        return [(there - here) / seconds for here, there in zip(self._last, values, strict=True)]

    def _in_range(self, q: ArrayLike) -> list[float]:
        values: list[float] = six(q, "q").tolist()
        for joint, (value, (low, high)) in enumerate(zip(values, self._ranges, strict=True)):
            if not low <= value <= high:
                raise BadValue(f"q[{joint}] ({JOINTS[joint]}) is {value:.4f} rad; expected {low:.4f} to {high:.4f}")
        return values

    def _check_step(self, values: list[float], now: float) -> None:
        if self._last is not None:
            excess = self._limit.excess(self._last, values, now)
            if excess is not None:
                raise BadValue(excess)
            return
        here = self._dialogue.here
        if here is None:
            here = self._context.state().q_target.tolist()
        for joint, (value, before) in enumerate(zip(values, here, strict=True)):
            if abs(value - before) > _NEAR:
                raise BadValue(
                    f"q[{joint}] ({JOINTS[joint]}) is {value:.4f} rad, {abs(value - before):.4f} rad from where the "
                    f"arm is; at most {_NEAR:.4f} rad"
                )

"""Closed loops: set-points as the user's own loop makes them."""

from __future__ import annotations

import contextlib
import math
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, InvalidStateError
from concurrent.futures import TimeoutError as FutureTimeout
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from linkcore.errors import BadValue, Closed, LinkError, LinkTimeout, LocalError
from linkcore.handle import Motion

from ..interfaces.realtime.packets import RealtimeState
from ..urscript.programs import InputRegisters, ReverseSocket
from ..vectors import JOINTS, six
from .context import MotionContext
from .linked import CONNECT_TIMEOUT, Link, LinkedProgram
from .setpoints import STOP_WORD, WAIT_WORD, Servoing, setpoint
from .speed_limit import SpeedLimit

if TYPE_CHECKING:
    from typing_extensions import Self

__all__ = ["Servo", "ServoStatistics"]

#: Intervals that the statistics look back on: a minute and a half at 500 Hz.
_REMEMBERED = 50_000
#: rad that the first set-point may be away from where the arm is led.
_NEAR = 0.05
#: Seconds that the reason of a lost connection has to arrive.
_REASON = 1.5
#: Seconds that the program has to end when the block is left.
_END_TIMEOUT = 2.0


@dataclass(frozen=True)
class ServoStatistics:
    """How evenly set-points were sent.

    Attributes:
        count: set-points sent.
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


class _Waiting:
    """What is said to the streaming program by itself: that somebody is there, until the first set-point is sent."""

    farewell = STOP_WORD
    is_over = False
    survives_its_program = False

    def __init__(self, servoing: Servoing) -> None:
        self._servoing = servoing
        #: rad; where the arm is led
        self.here: list[float] | None = None
        self.has_begun = False

    def body(self, link: ReverseSocket | InputRegisters) -> list[str]:
        return self._servoing.body(link)

    def step(self, received: bytes, state: RealtimeState, now: float) -> bytes:
        if self.has_begun:
            return b""
        self.here = state.q_target.tolist()
        return WAIT_WORD

    def conclude(self) -> None: ...


class Servo(Motion):
    """A loop's line to the joints; made by `robot.motion.servo`, and open within a ``with`` block.

    Send a set-point in each of the controller's cycles, or in each of your own. Leaving the block stops the arm.

    Attributes:
        rate: set-points a second that are meant to be sent.
    """

    def __init__(self, context: MotionContext, rate: float, servoing: Servoing, open_link: Callable[[], Link]) -> None:
        life = context.programs.life("servo")
        super().__init__(life)
        self.rate = rate
        self._context = context
        self._dialogue = _Waiting(servoing)
        self._is_entered = False
        #: settled once the program has connected, or will not any more
        self._linked: Future[None] = Future()
        self._program = LinkedProgram(life, context, self._dialogue, open_link, on_linked=self._link_up)
        self._last: list[float] | None = None
        self._sent_at = 0.0
        self._count = self._late = 0
        self._began = 0.0
        self._intervals: deque[float] = deque(maxlen=_REMEMBERED)
        model = context.who.identity.arm
        self._ranges = [(-math.inf, math.inf)] * 6 if model is None else model.position_limits.tolist()
        self._limit = SpeedLimit(model, 1.0 / rate)
        self._cycle = 1.0 / servoing.firmware.rate

    def __enter__(self) -> Self:
        """Upload the program and wait until it has connected.

        Raises:
            ConnectFailed: it did not.
            SafetyStop, NotRunning: the arm may not be moved now.
            LocalError: the servo was used before; or in a callback that was subscribed with ``inline=True``.
            LinkError: what else kept it from beginning.
        """
        if self._is_entered:
            raise LocalError("the servo has been used before; each is good for one block")
        self._is_entered = True
        self._program.begin()
        try:
            with self._context.section.waiting():
                self._linked.result(CONNECT_TIMEOUT + 1.0)
        except (FutureTimeout, TimeoutError):
            self.cancel()
            raise LinkTimeout(f"{self.name}: no connection within {CONNECT_TIMEOUT:g} s") from None
        except BaseException:
            self.cancel()
            raise
        if self.error is not None:
            raise self.error
        return self

    def _link_up(self) -> None:
        if not self._linked.done():
            # Two threads may come here at once.
            with contextlib.suppress(InvalidStateError):
                self._linked.set_result(None)

    def __exit__(self, *exc: object) -> None:
        """Stop the arm, and wait until it stands or two seconds are over. Does not raise what ended it before."""
        try:
            self._program.finish()
            self.wait(_END_TIMEOUT)
        except LinkError:
            self.cancel()

    def send(self, q: ArrayLike) -> None:
        """Send one set-point.

        Args:
            q: (6,) joint positions, rad. The first is no further than 0.05 rad from where the arm is. After that no
                joint is led faster than it can move; what is refused, and how uneven a loop may be, says
                `urlink.motion.speed_limit`.

        Raises:
            BadValue: not six finite numbers, too fast, or beyond a limit of the arm; nothing was sent.
            SafetyStop, NotRunning, ConnectionLost, ProgramStopped, Cancelled: it is over.
            LocalError: not within the block.
        """
        if not self._linked.done():
            raise LocalError("a servo takes set-points within its block: with robot.motion.servo() as servo: ...")
        if self.done or self._program.is_finishing:
            raise self.error or Closed("the block of the servo was left")
        now = self._context.clock()
        values = self._checked(q, now)
        try:
            self._program.say(setpoint(values, self._speeds(values, now)))
        except LinkError as error:
            raise self._reason(error) from error
        self._limit.take(self._last or values, values, now)
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
        """How evenly set-points were sent; deviations are of the last 50000 intervals."""
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

    def _checked(self, q: ArrayLike, now: float) -> list[float]:
        values: list[float] = six(q, "q").tolist()
        for joint, (value, (low, high)) in enumerate(zip(values, self._ranges, strict=True)):
            if not low <= value <= high:
                raise BadValue(f"q[{joint}] ({JOINTS[joint]}) is {value:.4f} rad; expected {low:.4f} to {high:.4f}")
        if self._last is not None:
            excess = self._limit.excess(self._last, values, now)
            if excess is not None:
                raise BadValue(excess)
            return values
        here = self._dialogue.here
        if here is None:
            here = self._context.state().q_target.tolist()
        for joint, (value, before) in enumerate(zip(values, here, strict=True)):
            if abs(value - before) > _NEAR:
                raise BadValue(
                    f"q[{joint}] ({JOINTS[joint]}) is {value:.4f} rad, {abs(value - before):.4f} rad from where the "
                    f"arm is; at most {_NEAR:.4f} rad"
                )
        return values

    def _reason(self, error: LinkError) -> Exception:
        """Why nothing can be sent: what the robot says of it, where it says something in time."""
        if not self.done:
            self._program.lose(error)
            with contextlib.suppress(LinkError):
                self.wait(_REASON)
        return self.error or error

"""Closed loops: set-points as the user's own loop makes them."""

from __future__ import annotations

import contextlib
import math
import time
from collections import deque
from concurrent.futures import TimeoutError as FutureTimeout
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from linkcore.errors import BadValue, Closed, LinkError, LinkTimeout, LocalError

from ..interfaces.realtime.packets import RealtimeState
from ..vectors import JOINTS, six
from .equipment import Equipment
from .linked import CONNECT_TIMEOUT, LinkedMotion
from .reverse import ReverseLink
from .setpoints import STOP_WORD, WAIT_WORD, Servoing, setpoint
from .speed_limit import SpeedLimit

if TYPE_CHECKING:
    from collections.abc import Callable

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


class Servo(LinkedMotion):
    """A loop's line to the joints; made by `robot.motion.servo`, and open within a ``with`` block.

    Send a set-point in each of the controller's cycles, or in each of your own. Leaving the block stops the arm.

    Args:
        rate: set-points a second that are meant to be sent.
        servoing: how set-points are followed.
        begin: begins it, in place of any other motion.
    """

    def __init__(
        self,
        equipment: Equipment,
        rate: float,
        servoing: Servoing,
        begin: Callable[[Servo], object],
    ) -> None:
        super().__init__("servo", equipment)
        self.rate = rate
        self._servoing = servoing
        self._start_in_place = begin
        self._here: list[float] | None = None
        self._last: list[float] | None = None
        self._sent_at = 0.0
        self._count = self._late = 0
        self._began = 0.0
        self._intervals: deque[float] = deque(maxlen=_REMEMBERED)
        model = equipment.model
        self._positions: list[tuple[float, float]] = (
            [(-math.inf, math.inf)] * 6
            if model is None
            else [(low, high) for low, high in model.position_limits.tolist()]
        )
        self._speed_limit = SpeedLimit(model, 1.0 / rate)

    def __enter__(self) -> Self:
        """Upload the program and wait until it has connected.

        Raises:
            ConnectFailed: it did not.
            SafetyStop, NotRunning: the arm may not be moved now.
            LinkError: what else kept it from beginning.
        """
        self._start_in_place(self)
        if not self._is_linked.wait(CONNECT_TIMEOUT + 1.0):
            self.cancel()
            raise LinkTimeout(f"{self.name}: no connection within {CONNECT_TIMEOUT:g} s")
        if self._error is not None:
            raise self._error
        return self

    def __exit__(self, *exc: object) -> None:
        """Stop the arm, and wait until it stands or two seconds are over. Does not raise what ended it before."""
        try:
            self._conclude()
        except LinkError as error:
            self._fail(error)
        try:
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
            BadValue: not six finite numbers, out of reach in that time, or beyond a limit of the arm; nothing was sent.
            SafetyStop, NotRunning, ConnectionLost, ProgramStopped, MotionCancelled: it is over.
            LocalError: not within the block.
        """
        if not self._is_linked.is_set():
            raise LocalError("a servo takes set-points within its block: with robot.motion.servo() as servo: ...")
        if self.done or self._last_word is not None:
            raise self._error or Closed("the block of the servo was left")
        now = time.monotonic()
        values = self._checked(q)
        try:
            self._say(setpoint(values))
        except LinkError as error:
            raise self._reason(error) from error
        if self._last is None:
            self._began = now
        else:
            self._speed_limit.take(self._last, values)
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

    # ----------------------------------------------------------------------------------------------------

    def _checked(self, q: ArrayLike) -> list[float]:
        values: list[float] = six(q, "q").tolist()
        for joint, (value, (low, high)) in enumerate(zip(values, self._positions, strict=True)):
            if not low <= value <= high:
                raise BadValue(f"q[{joint}] ({JOINTS[joint]}) is {value:.4f} rad; expected {low:.4f} to {high:.4f}")
        if self._last is not None:
            excess = self._speed_limit.excess(self._last, values)
            if excess is not None:
                raise BadValue(excess)
            return values
        here = self._here
        if here is None:
            here = self._equipment.state().q_target.tolist()
        for joint, (value, before) in enumerate(zip(values, here, strict=True)):
            if abs(value - before) > _NEAR:
                raise BadValue(
                    f"q[{joint}] ({JOINTS[joint]}) is {value:.4f} rad, {abs(value - before):.4f} rad from where the "
                    f"arm is; at most {_NEAR:.4f} rad"
                )
        return values

    def _reason(self, error: LinkError) -> Exception:
        """Why nothing can be sent: what the robot says of it, where it says something in time."""
        if not self.done and self._lost is None:
            self._lose(error)
        with contextlib.suppress(FutureTimeout, TimeoutError):
            self._future.exception(_REASON)
        return self._error or error

    def _body(self, host: str, port: int) -> list[str]:
        return self._servoing.body(self._equipment.firmware, host, port)

    def _farewell(self) -> bytes:
        return STOP_WORD

    def _step(self, link: ReverseLink, state: RealtimeState) -> None:
        link.received()  # it sends nothing, but this shows that it is there
        if self._last is None:
            self._here = state.q_target.tolist()
            self._say(WAIT_WORD)

"""Chunks of a slow policy: the arm executes one chunk while the policy computes the next one.

Real-time chunking (https://arxiv.org/abs/2506.07339) needs the number of steps that the arm executes while the policy
computes. These steps are frozen: they come from the previous chunk, and the new chunk takes effect after them.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from linkcore import clock
from urlink import BadValue, Robot, TrajectoryPoint
from urlink.motion import PointStream
from urlink.packets import RealtimeState

if TYPE_CHECKING:
    from types import TracebackType

    from typing_extensions import Self

__all__ = ["ChunkFollower", "Moment"]

Floats = NDArray[np.float64]

#: Number of latencies that count. The longest of them decides.
_REMEMBERED = 10
#: Time in s that is added to a latency, because the new points have to reach the robot before they take effect.
_SENDING = 0.03
#: Longest time, in s, until a state arrives.
_STATE_TIMEOUT = 1.0


@dataclass(frozen=True)
class Moment:
    """Moment at which a policy observes the arm.

    Attributes:
        state: State of the arm.
        time: Time on the clock of the point stream, in s.
        frozen: Number of steps from this moment on that the arm takes from the previous chunk.
        planned: Rest of the previous chunk, shape (n, 6), in rad: row k is for the time `time` + k periods. The first
            `frozen` rows will be executed. Empty if the arm is at rest.
        at: Time of this moment on the clock `linkcore.clock.now()`, in s.
    """

    state: RealtimeState
    time: float
    frozen: int
    planned: Floats
    at: float


class ChunkFollower:
    """Execute chunks of joint positions, each of which is computed while the arm executes the one before.

    Use it as a ``with`` block::

        with ChunkFollower(robot, period=0.05) as follower:
            while is_wanted():
                moment = follower.observe()
                chunk = policy(moment.state, moment.planned, moment.frozen)
                follower.follow(moment, chunk)

    The number of frozen steps follows the longest of the last ten latencies from `observe` to `follow`. If a chunk
    comes later than expected, it takes effect as soon as possible, and counts as late. If no chunk comes, the arm
    brakes at the end of its last chunk. Leaving the block stops the arm.

    Args:
        robot: Connected robot, with firmware 3.4 or later.
        period: Time between two steps of a chunk, in s, 0.01 to 1.
        max_step: Maximum change of a joint from one step to the next, in rad. Any excess is left out.
        watchdog: Time in s without messages from this computer after which the robot brakes on its own.

    Attributes:
        late: Number of chunks that took effect later than after their frozen steps.

    Raises:
        BadValue: If an argument is invalid.
    """

    def __init__(self, robot: Robot, period: float, *, max_step: float = 0.05, watchdog: float = 1.0) -> None:
        for name, value, low, high in (("period", period, 0.01, 1.0), ("max_step", max_step, 1e-4, 0.5)):
            if not isinstance(value, (int, float)) or not low <= value <= high:
                raise BadValue(f"{name}={value!r}; expected a number from {low:g} to {high:g}")
        self._robot = robot
        self._period = float(period)
        self._max_step = float(max_step)
        self._stream: PointStream = robot.motion.stream(watchdog=watchdog)
        self._latencies: deque[float] = deque(maxlen=_REMEMBERED)
        #: positions of the current chunk, shape (n, 6), and the time of the first one on the clock of the stream
        self._plan: Floats = np.empty((0, 6))
        self._since = 0.0
        self.late = 0

    def __enter__(self) -> Self:
        self._stream.__enter__()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stream.__exit__(kind, error, trace)

    @property
    def stream(self) -> PointStream:
        """Point stream that moves the arm."""
        return self._stream

    @property
    def latency(self) -> float:
        """Longest of the last ten latencies, in s; 0.0 before the first chunk."""
        return max(self._latencies, default=0.0)

    def observe(self) -> Moment:
        """Return the state of the arm, and the steps that it executes while the policy computes.

        Raises:
            LinkTimeout: If no state arrives within a second.
        """
        state = self._robot.realtime.wait(_STATE_TIMEOUT)
        time, at = self._stream.time, clock.now()
        if self._stream.is_dry or not len(self._plan):
            return Moment(state, time, 0, np.empty((0, 6)), at)
        # The step in which the plan ends is not frozen, so that a chunk of the same length has steps left.
        count = max(math.floor((self._since - time) / self._period + len(self._plan) - 1e-9), 1)
        planned = self._planned(time + self._period * np.arange(count))
        frozen = math.ceil((self.latency + _SENDING) / self._period)
        return Moment(state, time, min(frozen, max(count - 2, 0)), planned, at)

    def follow(self, moment: Moment, chunk: ArrayLike) -> tuple[float, Floats]:
        """Execute a chunk after the frozen steps of the moment for which it was computed.

        Args:
            moment: Result of `observe`.
            chunk: Joint positions, shape (n, 6), in rad: row k is for the time of the observation + k periods. At least
                two rows must follow the frozen steps.

        Returns:
            The time on the clock of the stream at which the chunk takes effect, and the positions that the arm
            executes, shape (n, 6). Their first rows are the frozen steps.

        Raises:
            BadValue: If the chunk has a wrong shape, is too short, or contains a number that is not finite; or if the
                arm cannot follow it. The previous chunk stays.
            LimitExceeded: If a limit of the session would be exceeded. The previous chunk stays.
            SafetyStop, NotRunning, ConnectionLost, ProgramStopped, Cancelled: If the arm was stopped.
            LocalError: If called outside the ``with`` block.
        """
        self._latencies.append(clock.now() - moment.at)
        try:
            rows: Floats = np.asarray(chunk, np.float64)
        except (TypeError, ValueError):
            raise BadValue(f"the chunk is {chunk!r:.80}; expected rows of six joint positions") from None
        if rows.ndim != 2 or rows.shape[1] != 6 or not np.isfinite(rows).all():
            raise BadValue(f"the chunk has shape {rows.shape}; expected rows of six finite joint positions")
        frozen, period = moment.frozen, self._period
        if len(rows) < frozen + 2:
            raise BadValue(
                f"the chunk has {len(rows)} steps, and {frozen} of them are frozen, because the policy takes up to "
                f"{self.latency:.2f} s; expected at least {frozen + 2} steps"
            )
        rows = self._limited(rows, moment)
        speeds = np.gradient(rows, period, axis=0)
        since = moment.time + frozen * period
        points = [
            TrajectoryPoint(rows[k], moment.time + k * period, speeds[k]) for k in range(max(frozen, 1), len(rows))
        ]
        begins = self._stream.replace(since, points)
        self._plan, self._since = rows, moment.time
        if frozen and begins > since + 0.5 * period:
            self.late += 1
        return begins, rows

    def _planned(self, times: NDArray[np.floating[Any]]) -> Floats:
        """Return the planned positions at times on the clock of the stream, shape (n, 6)."""
        own = self._since + self._period * np.arange(len(self._plan))
        return np.stack([np.interp(times, own, column) for column in self._plan.T], axis=1)

    def _limited(self, rows: Floats, moment: Moment) -> Floats:
        """Replace the frozen steps by the planned steps, and limit the change from each step to the next."""
        limited = rows.copy()
        limited[: moment.frozen] = moment.planned[: moment.frozen]
        before = moment.planned[moment.frozen - 1] if moment.frozen else moment.state.q_target
        for k in range(moment.frozen, len(rows)):
            before = limited[k] = np.clip(rows[k], before - self._max_step, before + self._max_step)
        return limited

"""A trajectory handed over point by point: the robot interpolates by itself, and asks for the next one in good time.

For links that are too slow or too uneven to stream over. A point has to arrive while the arm moves to the one before,
so points should be further apart in time than an answer takes.
"""

from __future__ import annotations

import time
from collections.abc import Callable

from linkcore.errors import ConnectionLost

from ..commanding.handle import Program, ProgramPhase
from ..errors import ProgramStopped
from ..interfaces.realtime.packets import RealtimeState
from ..urscript import waypoints
from ..urscript.text import number
from .equipment import Equipment
from .following import Following, Tolerances, TrajectoryFeedback
from .reverse import ReverseLink
from .trajectory import Trajectory

__all__ = ["WaypointFollower"]

#: Seconds between two lines of the program, which are a heartbeat apart, after which it counts as gone.
_SILENCE = 3.0
#: Bytes in a line at most.
_LONGEST_LINE = 32


class WaypointFollower(Following):
    """Serves the points of a trajectory.

    The first point is the one where the arm stands, so that it leaves from there without a jump.

    Args:
        lookahead_time, gain: of ``servoj``.
    """

    def __init__(
        self,
        equipment: Equipment,
        trajectory: Trajectory,
        tolerances: Tolerances,
        feedback: Callable[[TrajectoryFeedback], object] | None,
        *,
        lookahead_time: float,
        gain: float,
    ) -> None:
        super().__init__(equipment, trajectory, tolerances, feedback)
        self._lookahead_time = lookahead_time
        self._gain = gain
        self._line = b""
        self._requests: list[int] = []
        self._heard: float | None = None
        self._is_served = False
        self._has_arrived = False
        self._is_over = False

    def _body(self, host: str, port: int) -> list[str]:
        return waypoints.interpolating(
            self._equipment.firmware,
            host,
            port,
            is_quintic=self._trajectory.is_quintic,
            lookahead_time=self._lookahead_time,
            gain=self._gain,
        )

    def _step(self, link: ReverseLink, state: RealtimeState) -> None:
        now = time.monotonic()
        if self._has_arrived:
            if self._t0 is None or self._follow_up(state, self._desired(state.time - self._t0)[0]):
                self._conclude()
                if self._is_over:
                    self._complete()
            return
        self._read(link.received(), now)
        while self._requests and self._answer(self._requests[0], state):
            self._requests.pop(0)
        if self._has_arrived or self._t0 is None:
            return
        assert self._heard is not None
        if now - self._heard > _SILENCE:
            raise ConnectionLost(f"the program on the robot has said nothing for {_SILENCE:g} s")
        t = state.time - self._t0
        if t < self._trajectory.duration:
            self._follow_up(state, self._desired(t)[0])

    def _on_program(self, program: Program) -> None:
        if program.phase is ProgramPhase.FINISHED and self._is_served:
            # It may be over, and its connection closed, before its last line was read.
            self._lost = None
            self._has_arrived = self._is_over = True
        else:
            super()._on_program(program)

    def _read(self, data: bytes, now: float) -> None:
        """Take apart the lines of the program."""
        if data or self._heard is None:
            self._heard = now
        *lines, self._line = (self._line + data).split(b"\n")
        if len(self._line) > _LONGEST_LINE:
            raise ProgramStopped(f"the program on the robot does not speak in numbers: {self._line[:50]!r}")
        for line in lines:
            try:
                self._requests.append(int(line))
            except ValueError:
                raise ProgramStopped(f"the program on the robot does not speak in numbers: {line[:50]!r}") from None

    def _answer(self, request: int, state: RealtimeState) -> bool:
        """Answer one request; False if it has to wait."""
        if request == waypoints.ARRIVED:
            self._has_arrived = True
        elif request == waypoints.BEAT:
            self._say(b"(1)\r\n")
        elif request == 0:
            if not self._rests(state):
                return False
            self._say(self._point(0, self._check_start(state)))
        else:
            if request == 2:
                # It has just handed over the first point to go to, and moves from now on.
                self._t0 = state.time
            if request < len(self._trajectory):
                self._say(self._point(request, self._trajectory.q[request].tolist()))
            else:
                self._is_served = True
                zeros = [0.0] * (waypoints.numbers_of_point(self._trajectory.is_quintic) - 1)
                self._say(_answer(waypoints.NO_MORE, zeros))
        return True

    def _point(self, index: int, q: list[float]) -> bytes:
        trajectory = self._trajectory
        numbers = [*q, *trajectory.qd[index].tolist()]
        if trajectory.qdd is not None:
            numbers += trajectory.qdd[index].tolist()
        since = trajectory.time[index] - trajectory.time[max(index - 1, 0)]
        return _answer(index, [*numbers, float(since)])


def _answer(index: int, numbers: list[float]) -> bytes:
    return f"({index}, {', '.join(map(number, numbers))})\r\n".encode()

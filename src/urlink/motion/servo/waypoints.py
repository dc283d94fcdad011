"""Trajectory that is sent point by point: the robot requests each point in advance, and interpolates on its own.

Use it if the connection is too slow or too irregular for a stream of set-points. Each point must arrive while the arm
moves to the previous point. Therefore the time between two points should be longer than the time from a request to its
answer.
"""

from __future__ import annotations

import math

from linkcore.errors import ConnectionLost

from ...command.program_time import ProgramTimer
from ...errors import ProgramStopped
from ...protocol.firmware import Firmware
from ...protocol.realtime.packets import RealtimeState
from ...script import waypoints
from ...script.links import InputRegisters, ReverseSocket
from ...script.text import number
from ..moves.trajectory import Trajectory
from .following import Following, Tolerances

#: Longest time in s without a line from the program, which also sends heartbeats. After this time, the program counts
#: as lost.
_SILENCE = 3.0
#: Maximum number of bytes in a line.
_LONGEST_LINE = 32


class WaypointServer(Following):
    """Dialogue that sends each point of a trajectory when the program on the robot requests this point.

    The first point that it sends is the current position of the arm, so that the arm starts without a jump.

    Args:
        firmware: Firmware of the controller.
        lookahead_time, gain: Parameters of ``servoj``.
    """

    farewell = b""

    def __init__(
        self, trajectory: Trajectory, tolerances: Tolerances, firmware: Firmware, lookahead_time: float, gain: float
    ) -> None:
        def write(link: ReverseSocket | InputRegisters) -> list[str]:
            assert isinstance(link, ReverseSocket), "the program requests its points, and registers cannot answer"
            is_quintic = trajectory.is_quintic
            return waypoints.interpolating(
                firmware, *link, is_quintic=is_quintic, lookahead_time=lookahead_time, gain=gain
            )

        super().__init__(write, trajectory, tolerances, ProgramTimer(1.0 / firmware.rate))
        self._next_time = float(trajectory.time[1])
        self._line = b""
        self._requests: list[int] = []
        #: distance that the arm moved along the trajectory during a pause, as a time on the trajectory in s
        self._skipped = 0.0
        #: time on the trajectory at which the arm resumed after a pause, in s, and its offset from the trajectory
        #: there, (6,) rad
        self._resumed: tuple[float, list[float]] | None = None
        self._received_at: float | None = None
        self._has_arrived = False
        #: time in s that has passed on the trajectory; None before the arm begins to move
        self._t: float | None = None

    def step(self, received: bytes, state: RealtimeState, now: float) -> bytes:
        """Return the message for a state and for the requests that the program has sent since the last state.

        Raises:
            BadValue: If the arm is not at the beginning of the trajectory.
            ConnectionLost: If the program has sent nothing for too long.
            LinkTimeout: If the arm does not come to rest.
            ProgramStopped: If the program has sent a line that is not a request.
            ToleranceExceeded: If the arm is too far from the trajectory.
        """
        passed, scaled = self._timer.passed(state, now)
        if self._t is not None:
            self._t = min(self._t + scaled, max(self._t, self._next_time))
            self._passed += passed
        self._read(received, now)
        answers = []
        while self._requests and (answer := self._answer(self._requests[0], state, now)) is not None:
            answers.append(answer)
            self._requests.pop(0)
        if self._t is not None and (self._has_arrived or self._t < self._trajectory.duration):
            self._compare(state, self._t)
        elif self._has_arrived:
            self.is_over = True
        if not self._has_arrived and self._received_at is not None and now - self._received_at > _SILENCE:
            raise ConnectionLost(f"the program on the robot has sent nothing for {_SILENCE:g} s")
        return b"".join(answers)

    def conclude(self) -> None:
        """Record that the program has ended on its own. The arm has then reached the last point."""
        self._has_arrived = True

    def _read(self, data: bytes, now: float) -> None:
        """Parse the lines that the program has sent."""
        if data or self._received_at is None:
            self._received_at = now
        *lines, self._line = (self._line + data).split(b"\n")
        if len(self._line) > _LONGEST_LINE:
            raise ProgramStopped(f"the program on the robot sent {self._line[:50]!r}; expected a number")
        for line in lines:
            try:
                self._requests.append(int(line))
            except ValueError:
                raise ProgramStopped(f"the program on the robot sent {line[:50]!r}; expected a number") from None

    def _answer(self, request: int, state: RealtimeState, now: float) -> bytes | None:
        """Return the answer to one request; None if the answer must be sent later."""
        if request == waypoints.ARRIVED:
            self._has_arrived = True
            return b""
        if request == waypoints.BEAT:
            return b"(1)\r\n"
        if request == waypoints.HELD:
            skipped, self._skipped = self._skipped, 0.0
            return f"({number(1.0 + skipped)})\r\n".encode()
        if request < 0:
            raise ProgramStopped(f"the program on the robot requested point {request}, which does not exist")
        if request == 0:
            return self._point(0, self._check_start(state)) if self._rest.is_reached(state, now) else None
        if request == 2 and self._t is None:
            # The program has received point 1, the first point that it moves to, so the arm moves from now on.
            self._t = self._passed = 0.0
        elif self._t is not None and request > 2:
            # When the program requests point n, the arm moves from point n - 3 to point n - 2.
            time = self._trajectory.time
            self._t = max(self._t, float(time[request - 3]))
            # After the request that follows the last point, the program requests nothing more.
            self._next_time = float(time[request - 2]) if request < len(time) else math.inf
        if request < len(self._trajectory):
            return self._point(request, self._trajectory.q[request].tolist())
            # All points have been sent, so the program may end before its last line is read.
        self.survives_its_program = True
        zeros = [0.0] * (waypoints.numbers_of_point(self._trajectory.is_quintic) - 1)
        return _line(waypoints.NO_MORE, zeros)

    def resume(self, state: RealtimeState) -> None:
        """Continue after a pause, from the position of the arm.

        The program then asks how far the arm has moved along the path.
        """
        super().resume(state)
        self._received_at = None
        if self._t is not None:
            before = self._t
            self._t = max(self._nearest(state.q_target.tolist(), before), before)
            self._skipped = self._t - before
            q = super().desired(self._t)[0]
            self._resumed = self._t, [a - b for a, b in zip(state.q_target.tolist(), q, strict=True)]

    def desired(self, t: float) -> tuple[list[float], list[float]]:
        """Return the desired positions, (6,) rad, and velocities, (6,) rad/s, at the time `t` on the trajectory."""
        q, qd = super().desired(t)
        if self._resumed is None:
            return q, qd
        began, away = self._resumed
        faded = min((t - began) / waypoints.FADING, 1.0)
        left = 1.0 - faded * faded * (3.0 - 2.0 * faded)
        return [a + left * b for a, b in zip(q, away, strict=True)], qd

    def _point(self, index: int, q: list[float]) -> bytes:
        trajectory = self._trajectory
        numbers = [*q, *trajectory.qd[index].tolist()]
        if trajectory.qdd is not None:
            numbers += trajectory.qdd[index].tolist()
        since = trajectory.time[index] - trajectory.time[max(index - 1, 0)]
        return _line(index, [*numbers, float(since)])


def _line(index: int, numbers: list[float]) -> bytes:
    return f"({index}, {', '.join(map(number, numbers))})\r\n".encode()

"""Pace of a stream's program: the pace that was last sent, and the pace that the program has reached so far."""

from __future__ import annotations

from collections import deque

from ...script.buffering import BRAKING, MOVING, PACING
from ..servo.following import AHEAD

#: Difference between two paces below which the new pace is not sent while points are queued.
_SAME = 1e-3


class ProgramPace:
    """Pace of a program along the points, for streams of several arms.

    The pace is the time on the points that passes per second of the program. It is 1 for a single stream.

    Attributes:
        now: Current pace of the program.
    """

    def __init__(self) -> None:
        self.now = 1.0
        #: the newest paces for the program; the oldest of them is the pace in the message that takes effect now
        self._wanted = deque([1.0], AHEAD + 1)
        self._sent = 1.0
        self._is_last_message = True

    def want(self, pace: float) -> None:
        """Set the pace for the program from now on.

        Call this method once for each state.
        """
        self._wanted.append(pace)

    def passed(self, phase: int, seconds: float) -> float:
        """Update the pace of the program, and return the time in s that has passed on the points.

        Args:
            phase: Phase of the program in its last report.
            seconds: Time that has passed for the program, in s.
        """
        change = PACING * seconds
        if phase in (MOVING, BRAKING):
            wanted = self._wanted[0] if phase == MOVING else 1.0
            self.now += min(max(wanted - self.now, -change), change)
        else:
            self.now = self._wanted[0]
        return self.now * seconds

    def send(self) -> float:
        """Return the pace for the message that is sent now."""
        self._sent, self._is_last_message = self._wanted[-1], True
        return self._sent

    @property
    def has_room_for_a_point(self) -> bool:
        """Whether the message that is sent now may be a point, which contains no pace."""
        return self._is_last_message or abs(self._wanted[-1] - self._sent) < _SAME

    def send_point(self) -> None:
        """Record that the message that is sent now is a point."""
        self._is_last_message = False

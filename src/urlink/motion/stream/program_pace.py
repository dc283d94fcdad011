"""Pace of a stream's program: the pace that was last sent, and the pace that the program has reached so far."""

from __future__ import annotations

from collections import deque

from ...script.buffering import BRAKING, MOVING, PACING
from ..servo.following import AHEAD

#: Difference of two paces below which the new one is not sent while points are queued.
_SAME = 1e-3


class ProgramPace:
    """Pace of a program along its points, for streams of several arms; 1 for a single stream.

    Attributes:
        now: Current pace of the program.
    """

    def __init__(self) -> None:
        self.now = 1.0
        #: paces for the program, up to the newest; a message takes as many states to have an effect
        self._wanted = deque([1.0], AHEAD + 1)
        self._sent = 1.0
        self._is_last_message = True

    def want(self, pace: float) -> None:
        """Set the pace for the program from now on. Call it once for each state."""
        self._wanted.append(pace)

    def passed(self, phase: int, seconds: float) -> float:
        """Return the time in s that has passed on the points, at the pace of the program, and update this pace.

        Args:
            phase: Phase of the program in its last report.
            seconds: Time that has passed on the clock of the program, in s.
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

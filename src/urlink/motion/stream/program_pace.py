"""The pace of the program of a stream: what it was sent, and what it keeps by now."""

from __future__ import annotations

from collections import deque

from ...script.buffering import BRAKING, MOVING, PACING
from ..servo.following import AHEAD

#: Difference of two paces that is not sent while points are waiting to be sent.
_SAME = 1e-3


class ProgramPace:
    """The pace at which a program passes its points, for streams of several arms; 1 for one by itself.

    Attributes:
        now: the pace of the program.
    """

    def __init__(self) -> None:
        self.now = 1.0
        #: those that the program is to have, up to the newest: a message takes so many states to have an effect
        self._wanted = deque([1.0], AHEAD + 1)
        self._sent = 1.0
        self._is_last_message = True

    def want(self, pace: float) -> None:
        """The program is to have this pace from now on. Once for each state."""
        self._wanted.append(pace)

    def passed(self, phase: int, seconds: float) -> float:
        """s on the points, of so many seconds of the program that have passed; with the pace as the program keeps it.

        Args:
            phase: of the program, as in its last report.
            seconds: on its clock.
        """
        change = PACING * seconds
        if phase in (MOVING, BRAKING):
            wanted = self._wanted[0] if phase == MOVING else 1.0
            self.now += min(max(wanted - self.now, -change), change)
        else:
            self.now = self._wanted[0]
        return self.now * seconds

    def send(self) -> float:
        """The pace for the message that is sent now."""
        self._sent, self._is_last_message = self._wanted[-1], True
        return self._sent

    @property
    def has_room_for_a_point(self) -> bool:
        """The message that is sent now may be a point, which carries no pace."""
        return self._is_last_message or abs(self._wanted[-1] - self._sent) < _SAME

    def send_point(self) -> None:
        """The message that is sent now is a point."""
        self._is_last_message = False

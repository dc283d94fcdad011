"""The life of a stream of points, as this computer knows it: whether the program takes points, and what it was asked.

The program takes points in epochs. A cut opens an epoch: from rest, from braking, or in the middle of the points that
it replaces. The program accepts a cut, or refuses it because it came too late. The epoch is closed when the program is
out of points. `TRANSITIONS` is the whole of it; docs/architecture.md shows the table. What is not in the table cannot
happen: it raises.
"""

from __future__ import annotations

import enum
from collections.abc import Mapping
from types import MappingProxyType


class FeedPhase(enum.Enum):
    """Whether the program takes points."""

    STARTING = "starting"  # the arm has to come to rest first
    CLOSED = "closed"  # the arm brakes or rests, and the program takes no points
    RESUMING = "resuming"  # the program was sent a cut, to go on from braking or rest
    OPEN = "open"  # the program takes points
    CLEARED = "cleared"  # as OPEN, and the end of the points was asked for by the user
    REPLACING = "replacing"  # the program was sent a cut, to take other points or none
    REPLACING_CLEARED = "replacing cleared"  # as REPLACING, from CLEARED


class FeedEvent(enum.Enum):
    """What can happen to the stream."""

    REST = "rest"  # the arm rests for the first time
    RESUME = "resume"  # a cut is sent, to go on
    REPLACE = "replace"  # a cut is sent, for other points
    ACCEPT = "accept"  # the program has accepted the cut
    REFUSE = "refuse"  # the program has refused the cut, which came too late
    CLEAR = "clear"  # the points end here, as the user has asked
    CLOSE = "close"  # the program brakes or rests


#: (phase, event) -> the phase after it
TRANSITIONS: Mapping[tuple[FeedPhase, FeedEvent], FeedPhase] = MappingProxyType(
    {
        (FeedPhase.STARTING, FeedEvent.REST): FeedPhase.CLOSED,
        (FeedPhase.CLOSED, FeedEvent.RESUME): FeedPhase.RESUMING,
        (FeedPhase.CLOSED, FeedEvent.CLOSE): FeedPhase.CLOSED,
        (FeedPhase.RESUMING, FeedEvent.ACCEPT): FeedPhase.OPEN,
        (FeedPhase.RESUMING, FeedEvent.REFUSE): FeedPhase.CLOSED,
        (FeedPhase.OPEN, FeedEvent.REPLACE): FeedPhase.REPLACING,
        (FeedPhase.OPEN, FeedEvent.CLEAR): FeedPhase.CLEARED,
        (FeedPhase.OPEN, FeedEvent.CLOSE): FeedPhase.CLOSED,
        (FeedPhase.CLEARED, FeedEvent.REPLACE): FeedPhase.REPLACING_CLEARED,
        (FeedPhase.CLEARED, FeedEvent.CLEAR): FeedPhase.CLEARED,
        (FeedPhase.CLEARED, FeedEvent.CLOSE): FeedPhase.CLOSED,
        (FeedPhase.REPLACING, FeedEvent.ACCEPT): FeedPhase.OPEN,
        (FeedPhase.REPLACING, FeedEvent.CLEAR): FeedPhase.CLEARED,
        (FeedPhase.REPLACING, FeedEvent.REFUSE): FeedPhase.OPEN,
        (FeedPhase.REPLACING_CLEARED, FeedEvent.ACCEPT): FeedPhase.OPEN,
        (FeedPhase.REPLACING_CLEARED, FeedEvent.CLEAR): FeedPhase.CLEARED,
        (FeedPhase.REPLACING_CLEARED, FeedEvent.REFUSE): FeedPhase.CLEARED,
    }
)

_CLOSED = (FeedPhase.STARTING, FeedPhase.CLOSED)
_CUT = (FeedPhase.RESUMING, FeedPhase.REPLACING, FeedPhase.REPLACING_CLEARED)


class FeedLife:
    """What one stream is doing.

    Attributes:
        phase: whether its program takes points.
    """

    def __init__(self) -> None:
        self.phase = FeedPhase.STARTING

    @property
    def is_open(self) -> bool:
        """An epoch is open, or a cut that opens one was sent."""
        return self.phase not in _CLOSED

    @property
    def is_cut(self) -> bool:
        """The program has not answered a cut."""
        return self.phase in _CUT

    def fire(self, event: FeedEvent) -> None:
        """Something has happened.

        Raises:
            RuntimeError: it cannot happen now.
        """
        after = TRANSITIONS.get((self.phase, event))
        if after is None:
            raise RuntimeError(f"a stream: {event.value!r} cannot happen while it is {self.phase.value}")
        self.phase = after

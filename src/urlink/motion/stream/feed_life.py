"""Phases of a point stream on this computer: whether the program accepts points, and which requests are pending.

The program accepts points in epochs. An epoch is opened by a cut: a message that replaces the buffered points, or lets
the program continue from rest or from braking. The program accepts a cut, or refuses the cut because it came too late.
An epoch is closed when the program has no more points. `TRANSITIONS` contains these rules as a table, which
docs/architecture.md shows. If an event is not possible in the current phase, an error is raised.
"""

from __future__ import annotations

import enum
from collections.abc import Mapping
from types import MappingProxyType


class FeedPhase(enum.Enum):
    """Phase of a stream: whether the program accepts points."""

    STARTING = "starting"  # the arm must come to rest first
    CLOSED = "closed"  # the arm brakes or is at rest, and the program accepts no points
    RESUMING = "resuming"  # a cut was sent, to continue from braking or from rest
    OPEN = "open"  # the program accepts points
    CLEARED = "cleared"  # like OPEN, but the user has ended the points
    REPLACING = "replacing"  # a cut was sent, to replace the points by others or by none
    REPLACING_CLEARED = "replacing cleared"  # like REPLACING, but the phase before was CLEARED


class FeedEvent(enum.Enum):
    """Event in the life of a stream."""

    REST = "rest"  # the arm is at rest for the first time
    RESUME = "resume"  # a cut is sent, to continue
    REPLACE = "replace"  # a cut is sent, for other points
    ACCEPT = "accept"  # the program has accepted the cut
    REFUSE = "refuse"  # the program has refused the cut, because it came too late
    CLEAR = "clear"  # the points end now, because the user has requested this
    CLOSE = "close"  # the program brakes or is at rest


#: (phase, event) -> the next phase
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
    """Current phase of one stream, which events change.

    Attributes:
        phase: Whether the program accepts points.
    """

    def __init__(self) -> None:
        self.phase = FeedPhase.STARTING

    @property
    def is_open(self) -> bool:
        """Whether an epoch is open, or a cut that opens one was sent."""
        return self.phase not in _CLOSED

    @property
    def is_cut(self) -> bool:
        """Whether the program has not yet answered a cut."""
        return self.phase in _CUT

    def fire(self, event: FeedEvent) -> None:
        """Record an event.

        Raises:
            RuntimeError: If the event is not possible in the current phase.
        """
        after = TRANSITIONS.get((self.phase, event))
        if after is None:
            raise RuntimeError(f"a stream: {event.value!r} cannot happen while it is {self.phase.value}")
        self.phase = after

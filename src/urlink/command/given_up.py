"""Life cycle of the last abandoned program that might still run: whether a stop was sent, or must still be sent.

When a program is abandoned, urlink sends a stop. No stop can be sent while a safety stop is active. While another
program is being sent, a stop must not be sent either, because it might stop that program instead. In both cases the
abandoned program is kept, and the stop is sent at the second state in which nothing prevents it.

`TRANSITIONS` describes the whole life cycle; docs/architecture.md shows it as a table. Messages of the controller and
calls of users arrive in different threads, so each event can happen in each phase.
"""

from __future__ import annotations

import enum
import math
from collections.abc import Mapping
from types import MappingProxyType


class GivenUpPhase(enum.Enum):
    """Phase of the program that was abandoned last."""

    NONE = "none"  # there is no such program, or it has ended
    STOPPING = "stopping"  # a stop was sent, and the controller has not reported the end of the program
    KEPT = "kept"  # a stop must still be sent
    CLEAR = "clear"  # like KEPT, but nothing prevented the stop in the last state


class GivenUpEvent(enum.Enum):
    """Event that changes the phase."""

    GIVE_UP = "give up"  # a stop is about to be sent
    DELIVER = "deliver"  # the stop was sent
    KEEP = "keep"  # the stop cannot be sent now
    MISS = "miss"  # the stop was sent, but might not have stopped the program
    FREE = "free"  # a state has arrived, and nothing prevents the stop
    HINDER = "hinder"  # a state has arrived, and the stop cannot or must not be sent
    END = "end"  # the program has ended or was replaced, or it is unknown which program runs


#: Next phase for each (phase, event). An event that is not listed for a phase does not change it.
TRANSITIONS: Mapping[tuple[GivenUpPhase, GivenUpEvent], GivenUpPhase] = MappingProxyType(
    {
        **{(phase, event): phase for phase in GivenUpPhase for event in GivenUpEvent},
        (GivenUpPhase.NONE, GivenUpEvent.GIVE_UP): GivenUpPhase.STOPPING,
        (GivenUpPhase.NONE, GivenUpEvent.KEEP): GivenUpPhase.KEPT,
        (GivenUpPhase.STOPPING, GivenUpEvent.KEEP): GivenUpPhase.KEPT,
        (GivenUpPhase.STOPPING, GivenUpEvent.MISS): GivenUpPhase.KEPT,
        (GivenUpPhase.KEPT, GivenUpEvent.DELIVER): GivenUpPhase.STOPPING,
        (GivenUpPhase.CLEAR, GivenUpEvent.DELIVER): GivenUpPhase.STOPPING,
        (GivenUpPhase.KEPT, GivenUpEvent.FREE): GivenUpPhase.CLEAR,
        (GivenUpPhase.CLEAR, GivenUpEvent.HINDER): GivenUpPhase.KEPT,
        **{(phase, GivenUpEvent.END): GivenUpPhase.NONE for phase in GivenUpPhase},
    }
)


class GivenUpProgram:
    """The program that was abandoned last, while it might still run.

    Attributes:
        phase: Phase of the program.
        name: Name of the program; None in the phase NONE.
        stop_sent: Time when a stop was sent, on the clock of `Programs`.
    """

    def __init__(self) -> None:
        self.phase = GivenUpPhase.NONE
        self.name: str | None = None
        self.stop_sent = -math.inf

    @property
    def is_kept(self) -> bool:
        """Whether a stop must still be sent."""
        return self.phase in (GivenUpPhase.KEPT, GivenUpPhase.CLEAR)

    def fire(self, event: GivenUpEvent, name: str | None = None) -> None:
        """Record an event. The caller must hold the lock of the robot's section.

        Args:
            event: Event that happened.
            name: Name of the program, if the event is about a different program than before.
        """
        self.phase = TRANSITIONS[self.phase, event]
        if self.phase is GivenUpPhase.NONE:
            self.name = None
        elif name is not None:
            self.name = name

"""The life of the program that was given up and may still run: whether it was sent a stop, or has to be sent one.

A program that was given up is sent a stop. While a safety stop holds, no stop can be sent. While another program is on
its way, a stop might stop that program instead. Then the program is kept, and it is sent a stop by the second state in
which nothing prevents that. `TRANSITIONS` is the whole of it; docs/architecture.md shows the table. Messages of the
controller and calls of users come in different threads, so each event can happen in each phase.
"""

from __future__ import annotations

import enum
import math
from collections.abc import Mapping
from types import MappingProxyType


class GivenUpPhase(enum.Enum):
    """What is known of the program that was given up last."""

    NONE = "none"  # there is none, or it has ended
    STOPPING = "stopping"  # it was sent a stop, and the controller has not reported its end
    KEPT = "kept"  # it has to be sent a stop
    CLEAR = "clear"  # as KEPT, and by the last state nothing prevented the stop


class GivenUpEvent(enum.Enum):
    """What can happen to it."""

    GIVE_UP = "give up"  # a stop is about to be sent
    DELIVER = "deliver"  # the stop was sent
    KEEP = "keep"  # the stop cannot be sent now
    MISS = "miss"  # the stop was sent, and may not have stopped it
    FREE = "free"  # a state has come, and nothing prevents the stop
    HINDER = "hinder"  # a state has come, and something prevents the stop
    END = "end"  # it has ended or was replaced, or it is not known which program runs


#: (phase, event) -> the phase after it. The events leave other phases as they are.
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
    """The program that was given up last, while it may still run.

    Attributes:
        phase: what is known of it.
        name: its name; None in the phase NONE.
        stop_sent: when it was sent a stop, on the clock of its programs.
    """

    def __init__(self) -> None:
        self.phase = GivenUpPhase.NONE
        self.name: str | None = None
        self.stop_sent = -math.inf

    @property
    def is_kept(self) -> bool:
        """It has to be sent a stop."""
        return self.phase in (GivenUpPhase.KEPT, GivenUpPhase.CLEAR)

    def fire(self, event: GivenUpEvent, name: str | None = None) -> None:
        """Something has happened. With the section of the robot.

        Args:
            event: what.
            name: of the program, if it is another one from now on.
        """
        self.phase = TRANSITIONS[self.phase, event]
        if self.phase is GivenUpPhase.NONE:
            self.name = None
        elif name is not None:
            self.name = name

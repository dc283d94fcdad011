"""The directive `life`: a table of transitions as it is in the code: of a connection, for example."""

from __future__ import annotations

from enum import Enum
from pathlib import Path
from typing import Any

from _tables import table
from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

from linkcore import handle
from linkcore.streaming import connection_life
from urlink.command import given_up

_NONE = "-"


class LifeDirective(SphinxDirective):
    """A row for each event, a column for each phase: the phase after it, and in brackets what subscribers are told.

    Where an event needs another one before it, a last column has that.
    """

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        """The life of a `connection`, of a `handle`, or of the program that was `given_up`."""
        after: dict[tuple[Any, Any], str]
        before: dict[Any, str] = {}
        all_phases: type[Enum]
        events: type[Enum]
        if self.arguments[0] == "connection":
            module: Any = connection_life
            all_phases, events = connection_life.ConnectionPhase, connection_life.LifeEvent
            after = {
                key: phase.value + (f" ({told.name})" if told else "")
                for key, (phase, told) in connection_life.TRANSITIONS.items()
            }
        elif self.arguments[0] == "handle":
            module = handle
            all_phases, events = handle.Phase, handle.Event
            after = {key: phase.value for key, phase in handle.TRANSITIONS.items()}
            before = {event: earlier.value for event, earlier in handle.AFTER.items()}
        elif self.arguments[0] == "given_up":
            module = given_up
            all_phases, events = given_up.GivenUpPhase, given_up.GivenUpEvent
            after = {key: phase.value for key, phase in given_up.TRANSITIONS.items()}
        else:
            raise self.error(f"there is no life of {self.arguments[0]}; expected connection, handle or given_up")
        self.env.note_dependency(str(Path(module.__file__)))
        phases = [phase for phase in all_phases if any(key[0] is phase for key in after)]
        needs = ("only after",) if before else ()
        head = ("event", *(f"in {phase.value}" for phase in phases), *needs)
        rows = [
            (
                event.value,
                *(after.get((phase, event), _NONE) for phase in phases),
                *(before.get(event, _NONE) for _ in needs),
            )
            for event in events
        ]
        return [table(head, rows)]


def setup(app: Sphinx) -> dict[str, Any]:
    """Register the directive."""
    app.add_directive("life", LifeDirective)
    return {"parallel_read_safe": True, "parallel_write_safe": True}

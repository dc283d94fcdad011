"""The directive `life`: a table of state transitions from the code, for example of a connection."""

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
from urlink.motion.stream import feed_life

_NONE = "-"
#: Name -> the module with its TRANSITIONS, its phases, and its events
_LIVES: dict[str, tuple[Any, type[Enum], type[Enum]]] = {
    "connection": (connection_life, connection_life.ConnectionPhase, connection_life.LifeEvent),
    "handle": (handle, handle.Phase, handle.Event),
    "given_up": (given_up, given_up.GivenUpPhase, given_up.GivenUpEvent),
    "stream": (feed_life, feed_life.FeedPhase, feed_life.FeedEvent),
}


class LifeDirective(SphinxDirective):
    """A row for each event and a column for each phase. A cell is the next phase, with the notification in brackets.

    If an event requires an earlier one, a last column contains the earlier event.
    """

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        """Return the table of the named life."""
        after: dict[tuple[Any, Any], str] = {}
        name = self.arguments[0]
        if name not in _LIVES:
            raise self.error(f"there is no life of {name}; expected {', '.join(_LIVES)}")
        module, all_phases, events = _LIVES[name]
        for key, effect in module.TRANSITIONS.items():
            phase, told = effect if isinstance(effect, tuple) else (effect, None)
            after[key] = phase.value + (f" ({told.name})" if told else "")
        before = {event: earlier.value for event, earlier in getattr(module, "AFTER", {}).items()}
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

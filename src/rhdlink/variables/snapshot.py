"""Variables as users see them: one variable at one moment, and what a sync has changed."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from linkcore.clock import Stamp
from linkcore.text import html_table

from .database import Database, TimeStamp, VariableTable


@dataclass(frozen=True)
class Variable:
    """A variable at one moment.

    Attributes:
        name: in the robot's database.
        direction: "r" from robot to program, "w" from program to robot.
        identity: its id, the place in its table.
        length: 32-bit words.
        value: typed as it was declared; where it was not, an int if it is one word, else a read-only int32 array.
        stamp: when it was set, by the clock of who set it.
        updated: see `rhdlink.Variables.updated`.
        changed: see `rhdlink.Variables.changed`.
        fresh: see `rhdlink.Variables.fresh`.
        unit: as declared; "" for none.
        doc: as declared.
    """

    name: str
    direction: str
    identity: int
    length: int
    value: Any
    stamp: TimeStamp
    updated: bool
    changed: bool
    fresh: bool
    unit: str
    doc: str


@dataclass(frozen=True)
class Change:
    """A variable that came with another time stamp or another value.

    Attributes:
        value: typed as it was declared; where it was not, an int if it is one word, else a read-only int32 array.
        stamp: when it was set, by the clock of who set it.
        changed: whether the value differs from the one before.
    """

    value: Any
    stamp: TimeStamp
    changed: bool


@dataclass(frozen=True)
class Update:
    """What changed with one sync.

    Attributes:
        changes: by name; never empty.
        received: when it came, by the clocks of this machine.
    """

    changes: Mapping[str, Change]
    received: Stamp

    def __getitem__(self, name: str) -> Any:
        """The value of a variable that changed; KeyError if it did not."""
        return self.changes[name].value

    def __contains__(self, name: object) -> bool:
        return name in self.changes


def changes_in(
    database: Database, names: frozenset[str] | None, value_of: Callable[[VariableTable, int], Any]
) -> dict[str, Change]:
    """The variables whose time stamp or value has changed in the newest batch.

    Args:
        database: has taken that batch.
        names: of these variables; None for all.
        value_of: the value of a variable, by its table and its id.
    """
    changes: dict[str, Change] = {}
    # Of a read and a write variable with the same name the read variable stands.
    for table in (database.write, database.read):
        for identity in table.fresh.nonzero()[0].tolist():
            name = table.rows[identity].name
            if names is None or name in names:
                value = value_of(table, identity)
                changes[name] = Change(value, table.stamp(identity), bool(table.changed[identity]))
    return changes


def to_html(title: str, variables: Iterable[Variable]) -> str:
    """The variables as a table, for notebooks."""
    return html_table(title, ("name", "", "value", "unit", "stamp", "", ""), map(_row, variables))


def _row(variable: Variable) -> tuple[str, ...]:
    value = str(variable.value)
    return (
        variable.name,
        "read" if variable.direction == "r" else "write",
        value if len(value) <= 80 else value[:79] + "…",
        variable.unit,
        f"{variable.stamp.seconds}.{variable.stamp.microseconds:06d}",
        "fresh" if variable.fresh else "",
        variable.doc,
    )

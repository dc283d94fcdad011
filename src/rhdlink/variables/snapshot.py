"""Variables for users: one variable at one moment, and the changes of a sync."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from linkcore.clock import Stamp
from linkcore.text import html_table

from .database import Database, TimeStamp, VariableTable


@dataclass(frozen=True)
class Variable:
    """Variable at one moment.

    Attributes:
        name: Name in the robot's database.
        direction: "r" from robot to program, "w" from program to robot.
        identity: Id of the variable, which is its position in the table.
        length: Number of 32-bit words.
        value: Value in the declared type; for an undeclared variable, an int or a read-only int32 array.
        stamp: Time at which it was set, on the clock of the side that set it.
        updated: See `rhdlink.Variables.updated`.
        changed: See `rhdlink.Variables.changed`.
        fresh: See `rhdlink.Variables.fresh`.
        unit: Declared unit; "" for none.
        doc: Declared description.
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
    """Change of a variable, which arrived with a different time stamp or value.

    Attributes:
        value: Value in the declared type; for an undeclared variable, an int or a read-only int32 array.
        stamp: Time at which it was set, on the clock of the side that set it.
        changed: Whether the value differs from the previous value.
    """

    value: Any
    stamp: TimeStamp
    changed: bool


@dataclass(frozen=True)
class Update:
    """Changes of one sync.

    Attributes:
        changes: Changes by name; never empty.
        received: Time at which they arrived, on the clocks of this computer.
    """

    changes: Mapping[str, Change]
    received: Stamp

    def __getitem__(self, name: str) -> Any:
        """Return the value of a variable that has changed. Raises KeyError if it has not changed."""
        return self.changes[name].value

    def __contains__(self, name: object) -> bool:
        return name in self.changes


def changes_in(
    database: Database, names: frozenset[str] | None, value_of: Callable[[VariableTable, int], Any]
) -> dict[str, Change]:
    """Collect the variables whose time stamp or value changed in the newest batch.

    Args:
        database: Database that has received the batch.
        names: Names of the wanted variables; None for all.
        value_of: Function that returns the value of a variable, called with its table and its id.
    """
    changes: dict[str, Change] = {}
    # If a read and a write variable have the same name, the read variable is kept.
    for table in (database.write, database.read):
        for identity in table.fresh.nonzero()[0].tolist():
            name = table.rows[identity].name
            if names is None or name in names:
                value = value_of(table, identity)
                changes[name] = Change(value, table.stamp(identity), bool(table.changed[identity]))
    return changes


def to_html(title: str, variables: Iterable[Variable]) -> str:
    """Render the variables as an HTML table, for notebooks."""
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

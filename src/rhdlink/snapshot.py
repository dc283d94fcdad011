"""The variables of a robot at one moment, to look at."""

from __future__ import annotations

import html
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from .database import TimeStamp

__all__ = ["Variable", "to_html"]


@dataclass(frozen=True)
class Variable:
    """A variable at one moment.

    Attributes:
        name: in the robot's database.
        direction: "r" from robot to program, "w" from program to robot.
        identity: its id, the place in its table.
        length: 32-bit words.
        value: typed as it was declared; a read-only int32 array where it was not.
        stamp: when it was set, by the clock of who set it.
        updated: see `rhdlink.database`.
        changed: likewise.
        fresh: likewise.
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


def to_html(title: str, variables: Iterable[Variable]) -> str:
    """The variables as a table, for notebooks. Names and text come from the robot, so they are escaped."""
    columns = ("name", "", "value", "unit", "stamp", "", "")
    head = "".join(f"<th>{column}</th>" for column in columns)
    rows = "".join(_row(variable) for variable in variables)
    return f"<table><caption>{html.escape(title)}</caption><thead><tr>{head}</tr></thead><tbody>{rows}</tbody></table>"


def _row(variable: Variable) -> str:
    value = str(variable.value)
    cells = (
        variable.name,
        "read" if variable.direction == "r" else "write",
        value if len(value) <= 80 else value[:79] + "…",
        variable.unit,
        f"{variable.stamp.seconds}.{variable.stamp.microseconds:06d}",
        "fresh" if variable.fresh else "",
        variable.doc,
    )
    return "<tr>" + "".join(f"<td>{html.escape(cell)}</td>" for cell in cells) + "</tr>"

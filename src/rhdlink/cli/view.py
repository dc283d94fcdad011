"""How the variables of a robot are shown: their words and what they mean, on a line, in a table, as JSON, and live.

A robot sends names and lengths, but no types and units. The ready-made classes declare those of the conventional
names; a declaration is used if its direction and length match as well.

The panel of `watch` needs rich, which is imported when one is drawn.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from linkcore.errors import BadValue
from linkcore.streaming.connection_life import ConnectionEvent, ConnectionState
from linkcore.text import printable

from ..robots import Ackerman, Gps, Smr, VelocityOmega
from ..variables.declarations import Declaration
from ..variables.snapshot import Update, Variable
from ..variables.value_types import Bool, Float32, Float64, Int32, Int64, Millionths, Order, UInt32, ValueType
from ..wire.data import Words

if TYPE_CHECKING:
    from rich.console import Console, ConsoleOptions, RenderResult

_TYPES: tuple[ValueType[Any, Any, Any], ...] = (Int32, UInt32, Int64, Float32, Float64, Bool, Millionths)
#: Types that can be named on the command line: "int32", "uint32", ...
TYPES = {repr(each).lower(): each for each in _TYPES}

#: Words of a variable that are shown on one line.
_MOST_WORDS = 16
#: Seconds over which rates are counted.
WINDOW = 2.0

_STATUS = {
    ConnectionState.CONNECTED: "bold black on green",
    ConnectionState.CONNECTING: "black on yellow",
    ConnectionState.LOST: "bold white on red",
}
_LABEL = "bright_black"


def _known() -> dict[tuple[str, str, int], Declaration[Any, Any]]:
    known: dict[tuple[str, str, int], Declaration[Any, Any]] = {}
    for robot in (Smr, VelocityOmega, Ackerman, Gps):
        for declaration in robot.declared().values():
            known.setdefault((declaration.direction, declaration.name, declaration.length), declaration)
    return known


_KNOWN = _known()


def in_units(direction: str, name: str, words: Words) -> str:
    """The value with its unit: ``0.3 m/s``; "" where the name has none."""
    declaration = _KNOWN.get((direction, name, len(words)))
    if declaration is None or not declaration.unit:
        return ""
    value = declaration.unpack(words, declaration.order or "little")
    if isinstance(value, (np.ndarray, tuple)):
        text = " ".join(f"{each:.6g}" for each in value)
    else:
        text = f"{value:.6g}" if isinstance(value, float) else str(value)
    return f"{text} {declaration.unit}"


def words_of(value: int | Words) -> Words:
    """The words of a variable that was not declared: its value is an int or an array (see `Variable`)."""
    return np.atleast_1d(np.asarray(value, np.int32))


def typed(name: str, words: Words, type_name: str, order: Order) -> list[int | float | bool]:
    """The values in the words of a variable.

    Raises:
        BadValue: the number of words is not a multiple of those of the type.
    """
    value_type = TYPES[type_name]
    size = value_type.length(1)
    count, left = divmod(len(words), size)
    if left or not count:
        raise BadValue(f"{name} has {len(words)} words; a {type_name} takes {size}")
    found: list[int | float | bool] = np.atleast_1d(value_type.unpack_many(words, count, order)).tolist()
    return found


def words_text(words: Words, most: int | None = _MOST_WORDS) -> str:
    """The words of a variable, on one line."""
    shown = [str(int(word)) for word in words[:most]]
    left = len(words) - len(shown)
    return " ".join(shown) + (f" … {left} more" if left else "")


def with_meaning(direction: str, name: str, words: Words, most: int | None = _MOST_WORDS) -> str:
    """The words of a variable, at most so many of them, and their meaning if the name has one: ``30000 = 0.3 m/s``."""
    meaning = in_units(direction, name, words)
    return words_text(words, most) + (f" = {meaning}" if meaning else "")


def as_json(variable: Variable) -> dict[str, Any]:
    """A variable as a JSON object; its value always as a list of words."""
    words = words_of(variable.value)
    return {
        "name": variable.name,
        "direction": variable.direction,
        "id": variable.identity,
        "length": variable.length,
        "words": words.tolist(),
        "stamp": [variable.stamp.seconds, variable.stamp.microseconds],
        "meaning": in_units(variable.direction, variable.name, words) or None,
    }


def as_columns(variable: Variable) -> tuple[str, ...]:
    """A variable for a table: direction, id, name, words, meaning, time stamp."""
    words = words_of(variable.value)
    meaning = in_units(variable.direction, variable.name, words)
    return (
        {"r": "read", "w": "write"}[variable.direction],
        str(variable.identity),
        printable(variable.name),
        words_text(words),
        f"= {meaning}" if meaning else "",
        f"{variable.stamp.seconds}.{variable.stamp.microseconds:06d}",
    )


def update_as_json(update: Update) -> dict[str, Any]:
    """The value, and when it was received."""
    return {
        "received": update.received.wall,
        "variables": {name: words_of(change.value).tolist() for name, change in update.changes.items()},
        "stamps": {name: list(change.stamp) for name, change in update.changes.items()},
    }


@dataclass(frozen=True)
class View:
    """One moment of a robot.

    Attributes:
        robot: its address.
        connection: state of the connection.
        age: seconds since the newest values came.
        rate: syncs with new values per second; None in the first half second.
        rates: name -> how often per second it was set.
        variables: those that are watched.
        reconnects: connections after the first.
        trouble: the error that ended the last connection; None while connected.
    """

    robot: str
    connection: ConnectionState
    age: float
    rate: float | None
    rates: dict[str, float]
    variables: Sequence[Variable]
    reconnects: int
    trouble: str | None

    @property
    def is_fresh(self) -> bool:
        """Whether the values are current."""
        return self.connection is ConnectionState.CONNECTED

    def as_line(self) -> str:
        """The view on one line; old values are marked as old."""
        parts = [f"{time.strftime('%H:%M:%S')} {self.connection.name}", printable(self.robot)]
        if not self.is_fresh:
            parts.append(f"OLD DATA, {self.age:.1f} s")
            if self.trouble is not None:
                parts.append(printable(self.trouble))
        else:
            parts.append("- syncs/s" if self.rate is None else f"{self.rate:.1f} syncs/s")
        for variable in self.variables:
            value = with_meaning(variable.direction, variable.name, words_of(variable.value))
            rate = self.rates.get(variable.name)
            parts.append(f"{printable(variable.name)} {value}" + (f" ({rate:.1f}/s)" if rate else ""))
        return " | ".join(parts)

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        """The view as a panel, for rich."""
        from rich import box
        from rich.panel import Panel
        from rich.table import Table
        from rich.text import Text

        head = Text(no_wrap=True, overflow="ellipsis")
        head.append(f" {self.connection.name} ", _STATUS.get(self.connection, "black on white"))
        if self.is_fresh:
            head.append("   – syncs/s" if self.rate is None else f"   {self.rate:.1f} syncs/s", "bold")
        else:
            head.append(f"   old values, {self.age:.1f} s", "bold red")
            if self.trouble is not None:
                head.append(f"   {printable(self.trouble)}")
        head.append(f"   reconnects {self.reconnects}", _LABEL)
        table = Table(box=None, padding=(0, 2, 0, 0), header_style=_LABEL)
        table.add_column("")
        table.add_column("name", no_wrap=True)
        table.add_column("words", overflow="fold")
        table.add_column("meaning", no_wrap=True)
        table.add_column("set", justify="right", no_wrap=True)
        for variable in self.variables:
            rate = self.rates.get(variable.name)
            words = words_of(variable.value)
            table.add_row(
                "→" if variable.direction == "w" else "",
                Text(printable(variable.name), "bold" if rate else ""),
                Text(words_text(words)),
                Text(in_units(variable.direction, variable.name, words)),
                f"{rate:.1f}/s" if rate else "",
                style="" if self.is_fresh else "dim",
            )
        yield head
        yield Panel(table, title=Text(f" {printable(self.robot)} "), title_align="left", box=box.ROUNDED)


class RateCounter:
    """Counts updates over a window of two seconds; called by subscriptions, read by the view."""

    def __init__(self, began: float) -> None:
        self._lock = threading.Lock()
        self._began = began
        self._updates: deque[tuple[float, tuple[str, ...]]] = deque()
        self.trouble: str | None = None

    def on_update(self, update: Update) -> None:
        """Note which variables were set."""
        now = update.received.monotonic
        with self._lock:
            self._updates.append((now, tuple(update.changes)))
            self._forget(now)

    def on_connection(self, event: ConnectionEvent) -> None:
        """Keep the error of a lost connection until it is made again."""
        if event.error is not None:
            self.trouble = str(event.error)
        elif event.state is ConnectionState.CONNECTED:
            self.trouble = None
            with self._lock:
                self._began = event.received.monotonic
                self._updates.clear()

    def rates(self, now: float) -> tuple[float | None, dict[str, float]]:
        """Updates per second, and for each variable how often per second it was set; None and {} in the first 0.5 s."""
        with self._lock:
            self._forget(now)
            seconds = min(now - self._began, WINDOW)
            if seconds < 0.5:
                return None, {}
            counts: dict[str, int] = {}
            for _, names in self._updates:
                for name in names:
                    counts[name] = counts.get(name, 0) + 1
            return len(self._updates) / seconds, {name: count / seconds for name, count in counts.items()}

    def _forget(self, now: float) -> None:
        while self._updates and self._updates[0][0] < now - WINDOW:
            self._updates.popleft()

"""View of `rhdlink watch`: the variables, and how often each variable is set.

The panel needs rich, which is imported only when a panel is drawn.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from linkcore.streaming.connection_life import ConnectionEvent, ConnectionState
from linkcore.text import printable

from ..variables.snapshot import Update, Variable
from .variable_text import in_units, with_meaning, words_of, words_text

if TYPE_CHECKING:
    from rich.console import Console, ConsoleOptions, RenderResult

#: Time over which rates are counted, in s.
WINDOW = 2.0

_STATUS = {
    ConnectionState.CONNECTED: "bold black on green",
    ConnectionState.CONNECTING: "black on yellow",
    ConnectionState.LOST: "bold white on red",
}
_LABEL = "bright_black"


@dataclass(frozen=True)
class View:
    """State of a robot at one moment.

    Attributes:
        robot: Address of the robot.
        connection: State of the connection.
        age: Seconds since the newest values arrived.
        rate: Syncs with new values per second; None in the first half second.
        rates: Number of times per second that each variable was set, by name.
        variables: Watched variables.
        reconnects: Number of connections after the first.
        trouble: Error that ended the last connection; None while connected.
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
        """Format the view on one line. Old values are marked as old."""
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
        """Format the view as a panel, for rich."""
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
    """Counter of updates over a window of two seconds. Subscriptions call its methods, and the view reads its rates."""

    def __init__(self, began: float) -> None:
        self._lock = threading.Lock()
        self._began = began
        self._updates: deque[tuple[float, tuple[str, ...]]] = deque()
        self.trouble: str | None = None

    def on_update(self, update: Update) -> None:
        """Note the variables that were set."""
        now = update.received.monotonic
        with self._lock:
            self._updates.append((now, tuple(update.changes)))
            self._forget(now)

    def on_connection(self, event: ConnectionEvent) -> None:
        """Keep the error of a lost connection until the connection is made again."""
        if event.error is not None:
            self.trouble = str(event.error)
        elif event.state is ConnectionState.CONNECTED:
            self.trouble = None
            with self._lock:
                self._began = event.received.monotonic
                self._updates.clear()

    def rates(self, now: float) -> tuple[float | None, dict[str, float]]:
        """Return the updates per second, and the same for each variable by name; None and {} in the first 0.5 s."""
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

"""The view of `watch` as a panel on a terminal: the only module here that needs rich."""

from __future__ import annotations

from rich import box
from rich.console import Console, ConsoleOptions, RenderResult
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from linkcore.streaming.events import ConnectionState
from linkcore.text import printable

from .units import in_units, words_of, words_text
from .view import View

__all__ = ["ViewPanel"]

_STATUS = {
    ConnectionState.CONNECTED: "bold black on green",
    ConnectionState.CONNECTING: "black on yellow",
    ConnectionState.LOST: "bold white on red",
}
_LABEL = "bright_black"


class ViewPanel:
    """A view of the robot, as a rich renderable."""

    def __init__(self, view: View) -> None:
        self._view = view

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        view = self._view
        head = Text(no_wrap=True, overflow="ellipsis")
        head.append(f" {view.connection.name} ", _STATUS.get(view.connection, "black on white"))
        if view.is_fresh:
            head.append("   – syncs/s" if view.rate is None else f"   {view.rate:.1f} syncs/s", "bold")
        else:
            head.append(f"   old values, {view.age:.1f} s", "bold red")
            if view.trouble is not None:
                head.append(f"   {printable(view.trouble)}")
        head.append(f"   reconnects {view.reconnects}", _LABEL)
        table = Table(box=None, padding=(0, 2, 0, 0), header_style=_LABEL)
        table.add_column("")
        table.add_column("name", no_wrap=True)
        table.add_column("words", overflow="fold")
        table.add_column("meaning", no_wrap=True)
        table.add_column("set", justify="right", no_wrap=True)
        for variable in view.variables:
            rate = view.rates.get(variable.name)
            words = words_of(variable.value)
            table.add_row(
                "→" if variable.direction == "w" else "",
                Text(printable(variable.name), "bold" if rate else ""),
                Text(words_text(words)),
                Text(in_units(variable.direction, variable.name, words)),
                f"{rate:.1f}/s" if rate else "",
                style="" if view.is_fresh else "dim",
            )
        yield head
        yield Panel(table, title=Text(f" {printable(view.robot)} "), title_align="left", box=box.ROUNDED)

"""The view of `watch` as a picture: the only module here that needs rich."""

from __future__ import annotations

from rich import box
from rich.console import Console, ConsoleOptions, RenderResult
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from linkcore.cli.terminal import safe
from linkcore.streaming.events import ConnectionState

from .gauge import Sight
from .meaning import in_units, words_text

__all__ = ["Picture"]

_STATUS = {
    ConnectionState.CONNECTED: "bold black on green",
    ConnectionState.CONNECTING: "black on yellow",
    ConnectionState.LOST: "bold white on red",
}
_LABEL = "bright_black"


class Picture:
    """A sight of the robot, as a rich renderable."""

    def __init__(self, sight: Sight) -> None:
        self._sight = sight

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        sight = self._sight
        head = Text(no_wrap=True, overflow="ellipsis")
        head.append(f" {sight.connection.name} ", _STATUS.get(sight.connection, "black on white"))
        if sight.is_fresh:
            head.append("   – syncs/s" if sight.rate is None else f"   {sight.rate:.1f} syncs/s", "bold")
        else:
            head.append(f"   old values, {sight.age:.1f} s", "bold red")
            if sight.trouble is not None:
                head.append(f"   {safe(sight.trouble)}")
        head.append(f"   reconnects {sight.reconnects}", _LABEL)
        table = Table(box=None, padding=(0, 2, 0, 0), header_style=_LABEL)
        table.add_column("")
        table.add_column("name", no_wrap=True)
        table.add_column("words", overflow="fold")
        table.add_column("meaning", no_wrap=True)
        table.add_column("set", justify="right", no_wrap=True)
        for variable in sight.variables:
            rate = sight.rates.get(variable.name)
            table.add_row(
                "→" if variable.direction == "w" else "",
                Text(safe(variable.name), "bold" if rate else ""),
                Text(words_text(variable.value)),
                Text(in_units(variable.direction, variable.name, variable.value)),
                f"{rate:.1f}/s" if rate else "",
                style="" if sight.is_fresh else "dim",
            )
        yield head
        yield Panel(table, title=Text(f" {safe(sight.robot)} "), title_align="left", box=box.ROUNDED)

"""Drawing of the view of `urlink monitor` on a terminal. Only this module needs the package rich."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from itertools import groupby

from rich import box
from rich.console import Console, ConsoleOptions, Group, RenderResult
from rich.panel import Panel
from rich.rule import Rule
from rich.table import Table
from rich.text import Text

from linkcore.text import printable

from .monitor_view import MonitorView, Reading, StreamStatus, age_text, rate_text

#: Maximum width of the view, in columns. A narrower terminal has a narrower view.
WIDTH = 100
#: Width of the view, in columns, below which the bars are omitted.
_NARROW = 92
_JOINTS = ("base", "shoulder", "elbow", "wrist 1", "wrist 2", "wrist 3")
_TURN = 2 * math.pi
_BAR = 25

_LABEL = "bright_black"
_VALUE = "default"
_STATUS = {
    StreamStatus.CONNECTING: "black on yellow",
    StreamStatus.WAITING: "black on yellow",
    StreamStatus.CONNECTED: "bold black on green",
    StreamStatus.SLOW: "bold black on yellow",
    StreamStatus.SILENT: "bold black on yellow",
    StreamStatus.LOST: "bold white on red",
    StreamStatus.ENDED: "black on white",
}
_BORDER = {StreamStatus.CONNECTED: "cyan", StreamStatus.LOST: "red", StreamStatus.ENDED: "white"}
_GOOD = {"RUNNING", "NORMAL", "PLAYING", "FREEDRIVE", "BACKDRIVE"}
_CALM = {"IDLE", "STOPPED", "PAUSED", "PAUSING", "STOPPING", "RESUMING", "POWER_OFF", "POWER_ON", "BOOTING", "REDUCED"}
_CALM |= {"READY", "INITIALIZING", "INITIALISATION", "MOTOR_INITIALISATION", "NO_POWER", "DISCONNECTED"}
_CALM |= {"READY_FOR_POWER_OFF", "SHUTTING_DOWN", "RESET", "SIMULATED"}


class MonitorPanel:
    """View of the robot, as an object that rich can draw."""

    def __init__(self, view: MonitorView) -> None:
        self._view = view

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        view = self._view
        width = min(options.max_width, WIDTH)
        border = _BORDER.get(view.status, "yellow")
        rows: list[Table | Text | Rule] = [self._header()]
        rows.append(Rule(style=border, characters="─"))
        if view.reading is not None:
            rows += self._body(view.reading, width >= _NARROW)
        rows.append(_labelled("stream", self._counters()))
        if view.message is not None:
            rows.append(_labelled("message", Text(printable(view.message), _VALUE, overflow="ellipsis", no_wrap=True)))
        title = Text.assemble((f" {printable(view.robot)} ", "bold"), (f" {printable(view.address)} ", _LABEL))
        yield Panel(Group(*rows), title=title, title_align="left", border_style=border, box=box.ROUNDED, width=width)

    def _header(self) -> Text:
        view = self._view
        text = Text(no_wrap=True, overflow="ellipsis")
        text.append(f" {view.status.value} ", _STATUS[view.status])
        if view.is_fresh and view.reading is not None:
            text.append(f"   {rate_text(view)}", "bold")
            text.append("   age ", _LABEL).append(age_text(view.reading.age))
            return text
        if view.status is StreamStatus.ENDED:
            warning = "the recording has ended; these are its last values"
        elif view.reading is None:
            warning = "no state has arrived yet"
        else:
            warning = f"OLD DATA, {age_text(view.reading.age)}"
        text.append(f"  {warning}", "bold red" if view.status is StreamStatus.LOST else "bold yellow")
        if view.trouble is not None and view.status is not StreamStatus.ENDED:
            text.append(f"  {printable(view.trouble)}", _LABEL)
        return text

    def _counters(self) -> Text:
        stats = self._view.stats
        text = Text(no_wrap=True, overflow="ellipsis")
        text.append("received ", _LABEL).append(f"{stats.received}")
        losses = (
            ("missed", stats.missed or 0),
            ("duplicates", stats.duplicates or 0),
            ("failed", stats.failed),
            ("reconnects", stats.reconnects),
            ("skipped", stats.skipped),
        )
        for name, count in losses:
            text.append(f"   {name} ", _LABEL).append(f"{count}", "bold yellow" if count else "")
        return text

    def _body(self, reading: Reading, has_room: bool) -> list[Table | Text | Rule]:
        # Old values are drawn dim.
        shade: Callable[[str], str] = (lambda style: style) if self._view.is_fresh else (lambda style: "dim")
        rows: list[Table | Text | Rule] = []
        if reading.q is not None:
            rows += [_joints(reading, has_room, shade), Text()]
        if reading.pose is not None or reading.force is not None:
            rows += [_tool(reading, shade), Text()]
        rows.append(_labelled("modes", _modes(reading, shade)))
        if reading.digital_inputs is not None:
            rows.append(_labelled("inputs", _bits(reading.digital_inputs, shade)))
        if reading.digital_outputs is not None:
            rows.append(_labelled("outputs", _bits(reading.digital_outputs, shade)))
        if reading.analog:
            analog = Text(no_wrap=True, overflow="ellipsis")
            for place, group in groupby(reading.analog, key=lambda one: one.place):
                analog.append(f"{place} ", _LABEL)
                analog.append("  ".join(f"{one.value:.2f} {one.unit}" for one in group) + "   ", shade(_VALUE))
            rows.append(_labelled("analog", analog))
        return rows


def _labelled(label: str, text: Text) -> Table:
    row = Table.grid(padding=(0, 1), expand=True)
    row.add_column(width=9, style=_LABEL)
    row.add_column(ratio=1)
    row.add_row(label, text)
    return row


def _joints(reading: Reading, has_room: bool, shade: Callable[[str], str]) -> Table:
    assert reading.q is not None
    table = Table(box=None, expand=True, padding=(0, 1, 0, 0), header_style=_LABEL)
    table.add_column("joint", width=9, style=_LABEL)
    if has_room:
        table.add_column(Text("-360°" + "0".center(_BAR - 10) + "+360°", _LABEL), width=_BAR)
    for name, width in (("q deg", 9), ("q rad", 8), ("qd rad/s", 8), ("I A", 7), ("T °C", 6)):
        # A truncated number would be a wrong number, so the column with the modes is made narrower instead.
        table.add_column(name, justify="right", style=shade(_VALUE), no_wrap=True, min_width=width)
    table.add_column("  mode", no_wrap=True, ratio=1)
    for number, q in enumerate(reading.q):
        mode = "" if reading.joint_modes is None else reading.joint_modes[number]
        row: list[Text | str] = [_JOINTS[number] if number < len(_JOINTS) else str(number)]
        if has_room:
            row.append(_bar(q, shade))
        row += [
            Text(f"{math.degrees(q):9.2f}", shade("bold")),
            f"{q:8.4f}",
            _number(reading.qd, number, 8, 3),
            _number(reading.currents, number, 7, 2),
            _number(reading.temperatures, number, 6, 1),
            Text("  " + printable(mode), shade(_mood(mode))) if mode else Text("  –", _LABEL),
        ]
        table.add_row(*row)
    return table


def _bar(q: float, shade: Callable[[str], str]) -> Text:
    """Return a bar that shows the joint position between minus and plus one turn."""
    middle = _BAR // 2
    bar = "─" * middle + "┼" + "─" * middle
    if not math.isfinite(q):
        return Text(bar, _LABEL)
    at = round(min(max(q / _TURN, -1.0), 1.0) * middle) + middle
    return Text.assemble((bar[:at], _LABEL), ("●", shade("bold cyan")), (bar[at + 1 :], _LABEL))


def _tool(reading: Reading, shade: Callable[[str], str]) -> Table:
    table = Table(box=None, expand=True, padding=(0, 1, 0, 0), header_style=_LABEL)
    table.add_column("tool", width=9, style=_LABEL)
    for names, unit_width in ((("x", "y", "z"), 5), (("rx", "ry", "rz"), 6)):
        for name in names:
            table.add_column(name, justify="right", style=shade(_VALUE), no_wrap=True, min_width=9)
        table.add_column("", width=unit_width, style=_LABEL)
    lines = (
        ("pose", reading.pose, ("m", "rad"), 4),
        ("speed", reading.speed, ("m/s", "rad/s"), 3),
        ("force", reading.force, ("N", "Nm"), 2),
    )
    for name, vector, units, digits in lines:
        if vector is not None:
            # The width is fixed, so that the columns do not move when signs change.
            cells = [f"{value:9.{digits}f}" for value in vector]
            table.add_row(name, *cells[:3], units[0], *cells[3:], units[1])
    return table


def _number(vector: Sequence[float] | None, number: int, width: int, digits: int) -> str:
    return "–" if vector is None else f"{vector[number]:{width}.{digits}f}"


def _modes(reading: Reading, shade: Callable[[str], str]) -> Text:
    text = Text(overflow="ellipsis", no_wrap=True)
    for name, mode in (("robot", reading.robot_mode), ("safety", reading.safety_mode), ("program", reading.program)):
        text.append(f"{name} ", _LABEL)
        if mode is None:
            text.append("–   ", _LABEL)
        else:
            text.append(printable(mode), shade(_mood(mode))).append("   ")
    if reading.speed_scaling is not None:
        text.append("speed ", _LABEL).append(f"{reading.speed_scaling:.0%}", shade(_VALUE))
    return text


def _mood(mode: str) -> str:
    if mode in _GOOD:
        return "green"
    return "yellow" if mode in _CALM else "bold white on red"


def _bits(mask: int, shade: Callable[[str], str]) -> Text:
    text = Text(no_wrap=True)
    for name, first, count in (("0-7", 0, 8), ("8-15", 8, 8), ("16-17", 16, 2)):
        text.append(f"{name} ", _LABEL)
        for number in range(first, first + count):
            on = bool(mask >> number & 1)
            text.append("●" if on else "○", shade("bold green") if on else _LABEL)
        text.append("   ")
    if mask >> 18:
        text.append(f"and {mask >> 18 << 18:#x}", shade(_VALUE))
    return text

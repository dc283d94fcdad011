"""Tables of the effects on each motion and call when something fails, or when a program ends the motion or itself.

    python -m tests.urlink.afterwards.table     writes both tables into docs/reliability.md and docs/motion-ends.md

Every cell of the first table is a case of `test_afterwards.py`, on each firmware that supports the row. Every cell of
the second table is a case of `test_ends.py`, or of `test_interrupts.py` for Ctrl-C.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from linkcore.wire.fields import Since
from urlink.protocol.firmware import Firmware

__all__ = ["CALLED", "COLUMNS", "FIRMWARES", "ROWS", "Row", "cases", "cells", "firmwares", "pages"]

#: Arm for each firmware.
FIRMWARES = {"3.15": "ur5", "5.11": "ur5e", "10.12": "ur5e"}
#: Events while the arm moves.
UNDER_WAY = ("cut", "silence", "suspended controller", "suspended client", "killed client", "reboot")
#: The call is made while the controller is suspended, and fails; then the controller resumes.
CALLED = "called meanwhile"
COLUMNS = (*UNDER_WAY, CALLED)

#: Ways in which a program ends a motion or ends itself, by their names in `client.py`.
ENDS_HERE = ("block left", "close", "exit")
#: Columns of the second table.
HEADS = ("Ctrl-C during a wait", "its block ends", "`robot.close()`", "exit, SIGTERM", "SIGKILL")

#: Texts of the cells.
GOES_ON, BRAKES, ENDS = "continues to its end", "brakes", "stops"
NOT, BACK, LATE = "does not move", "is undone", "**is executed**"

_DOCS = Path(__file__).resolve().parents[3] / "docs"
_PAGE, _ENDS_PAGE = _DOCS / "reliability.md", _DOCS / "motion-ends.md"
_BETWEEN = re.compile(r"(?<=<!-- afterwards -->\n\n).*?(?=\n<!-- the end of it -->)", re.DOTALL)


_ALWAYS, _X = Since("1.6"), Since("10.7")


@dataclass(frozen=True)
class Row:
    """Kind of motion or call.

    Attributes:
        title: Title on the page.
        led: Whether it is commanded over a link, so that the robot brakes when this computer is no longer connected.
        called: Effect if it is called while the controller is suspended.
        by_api: Effect on PolyScope X, if it differs from `called`.
        within: Time limit for the arm to come to rest if it brakes, in s of the robot's time.
        lasts: Whether it lasts for some time.
        since: Firmware that supports it.
        interrupted: Effect of Ctrl-C while a program waits for it; empty if a program cannot wait for it.
        left: Effect of leaving its block or cancelling its handle; empty if it has none.
        closed: Effect of closing the robot.
        exits: Effect of the end of the process, if the robot was not closed.
    """

    title: str
    led: bool = False
    called: str = NOT
    by_api: str = ""
    within: float = 1.5
    lasts: bool = True
    since: Since = _ALWAYS
    interrupted: str = BRAKES
    left: str = BRAKES
    closed: str = BRAKES
    exits: str = BRAKES

    def ends(self, how: str) -> str:
        """Return the effect of one of `ENDS_HERE`; empty if there is no such case."""
        return {"block left": self.left, "close": self.closed, "exit": self.exits}[how]

    def becomes(self, column: str, firmware: str) -> str:
        """Return the text of its cell; empty if there is no such case."""
        if column == CALLED:
            return self.by_api if self.by_api and Firmware.parse(firmware) in _X else self.called
        if not self.lasts:
            return ""
        if column == "reboot":
            return ENDS
        return BRAKES if self.led else GOES_ON


_CB3, _REGISTERS, _E = Since("3.0"), Since("3.9/5.3"), Since("5.10")

#: Rows by their names in `client.py`.
ROWS = {
    "move_joints": Row("`move_joints`"),
    "move_linear": Row("`move_linear`"),
    "move_circular": Row("`move_circular`"),
    "path": Row("`path`"),
    "play": Row("`Taught.play`"),
    "until_contact": Row("`until_contact`", since=Since("3.3")),
    "speed_short": Row("`speed_joints`, `speed_linear` up to 0.5 s", led=True),
    "speed_joints": Row("`speed_joints` for longer", led=True),
    "speed_linear": Row("`speed_linear` for longer", led=True),
    "speed_rtde": Row('`speed_joints`, `speed_linear` with `link="rtde"`', led=True, since=_REGISTERS),
    "follow": Row("`follow`", led=True),
    "follow_rtde": Row('`follow(link="rtde")`', led=True, since=_REGISTERS),
    "follow_low_bandwidth": Row("`follow(low_bandwidth=True)`", led=True, within=3.5, since=_CB3),
    "servo": Row("`servo`", led=True),
    "stream": Row("`stream`", led=True, within=3.0, since=Since("3.4")),
    "stream_rtde": Row('`stream(link="rtde")`', led=True, within=3.0, since=_REGISTERS),
    "jog": Row("`jog`", led=True),
    "force_mode": Row("`force_mode`", led=True, since=_CB3),
    "freedrive": Row("`freedrive`", led=True, since=_CB3),
    "teach": Row("`teach`", led=True, since=_CB3),
    "torque": Row("`torque`", led=True, since=Since("5.23/10.11")),
    "impedance": Row("`impedance`", led=True, since=Since("5.23/10.11")),
    "script": Row("`robot.script.run`"),
    "script_detached": Row("`robot.script.run(detached=True)`", closed=GOES_ON, exits=GOES_ON),
    "interpreter": Row("`interpreter.execute`", called=BACK, since=_E, left=GOES_ON),
    # With the Robot API, urlink first asks whether the program is paused.
    "dashboard_play": Row(
        "`robot.dashboard.play` (dashboard server or Robot API)",
        called=BACK,
        by_api=NOT,
        interrupted="",
        left="",
        closed=GOES_ON,
        exits=GOES_ON,
    ),
    "gripper": Row("`robot.gripper.move`, `set`", called=BACK, lasts=False),
    "urx": Row("`urlink.compat.urx`: `movej`", left="", closed=""),
    "ur_rtde": Row("`urlink.compat`: `moveJ`", since=_REGISTERS, left="", closed=""),
    "ur_rtde_speed": Row("`urlink.compat`: `speedJ`", led=True, since=_REGISTERS, left="", closed=""),
    "send_line": Row("`robot.script.send_line`", called=LATE, interrupted="", left="", closed=GOES_ON, exits=GOES_ON),
    "secondary": Row("`robot.script.run` with a `sec`", called=LATE, lasts=False),
    "power_on": Row("`robot.dashboard.power_on` (dashboard server or Robot API)", called=LATE, lasts=False),
    "brake_release": Row("`robot.dashboard.brake_release` (dashboard server or Robot API)", called=LATE, lasts=False),
}


def firmwares(name: str) -> list[str]:
    """Return the firmwares that support a row."""
    return [each for each in FIRMWARES if Firmware.parse(each) in ROWS[name].since]


def cells() -> Iterator[tuple[str, str, str]]:
    """Yield (firmware, row, column) of each case."""
    for name, row in ROWS.items():
        for column in COLUMNS:
            for firmware in firmwares(name):
                if row.becomes(column, firmware):
                    yield firmware, name, column


def cases() -> Iterator[tuple[str, str]]:
    """Yield (row, way of `ENDS_HERE`) of each case of the second table."""
    yield from ((name, how) for name, row in ROWS.items() for how in ENDS_HERE if row.lasts and row.ends(how))


def drawn() -> str:
    """Return the first table as Markdown; kinds with the same effects share one row."""
    heads = ("Running motion or call", *UNDER_WAY, "called while the controller is suspended")
    titles: dict[tuple[str, ...], list[str]] = {}
    for name, row in ROWS.items():
        having = firmwares(name)
        title = row.title if len(having) == len(FIRMWARES) else f"{row.title} ({', '.join(having)})"
        each = [dict.fromkeys(row.becomes(column, firmware) or "-" for firmware in having) for column in COLUMNS]
        titles.setdefault(tuple(map(" or ".join, each)), []).append(title)
    return _table(heads, titles)


def drawn_ends() -> str:
    """Return the second table as Markdown."""
    titles: dict[tuple[str, ...], list[str]] = {}
    for name, row in ROWS.items():
        if row.lasts:
            killed = row.becomes("killed client", firmwares(name)[0])
            cells = (row.interrupted, *map(row.ends, ENDS_HERE), killed)
            titles.setdefault(tuple(cell or "-" for cell in cells), []).append(row.title)
    return _table(("Running motion or call", *HEADS), titles)


def _table(heads: Sequence[str], titles: Mapping[tuple[str, ...], Sequence[str]]) -> str:
    lines = [f"| {' | '.join(heads)} |", "|" + " --- |" * len(heads)]
    lines += [f"| {' | '.join(('; '.join(alike), *what))} |" for what, alike in titles.items()]
    return "\n".join(lines) + "\n"


def pages() -> dict[Path, str]:
    """Return the text of each page with its current table."""
    made = {}
    for path, table in ((_PAGE, drawn()), (_ENDS_PAGE, drawn_ends())):
        text = path.read_text(encoding="utf-8")
        made[path], count = _BETWEEN.subn(lambda _, table=table: table, text)  # type: ignore[misc]
        assert count == 1, f"{path} has no place for the table"
    return made


if __name__ == "__main__":
    for path, text in pages().items():
        path.write_text(text, encoding="utf-8")

"""What becomes of each kind of motion and call when something fails: one table, from which docs/reliability.md is made.

    python -m tests.urlink.afterwards.table     writes it there

Every cell is a case of `test_afterwards.py`, on each firmware that has the row.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from linkcore.wire.fields import Since
from urlink.firmware import Firmware

__all__ = ["CALLED", "COLUMNS", "FIRMWARES", "ROWS", "Row", "cells", "drawn", "firmwares", "page"]

#: firmware -> arm
FIRMWARES = {"3.15": "ur5", "5.11": "ur5e", "10.12": "ur5e"}
#: What happens while the arm is under way.
UNDER_WAY = ("cut", "silence", "suspended controller", "suspended client", "killed client", "reboot")
#: The controller is suspended; the call fails, and then the controller goes on.
CALLED = "called meanwhile"
COLUMNS = (*UNDER_WAY, CALLED)

#: The words of the cells.
GOES_ON, BRAKES, ENDS = "goes on to its end", "brakes", "stops"
NOT, BACK, LATE = "does not move", "is taken back", "**is carried out**"

_PAGE = Path(__file__).resolve().parents[3] / "docs" / "reliability.md"
_BETWEEN = re.compile(r"(?<=<!-- afterwards -->\n\n).*?(?=\n<!-- the end of it -->)", re.DOTALL)


_ALWAYS, _X = Since("1.6"), Since("10.7")


@dataclass(frozen=True)
class Row:
    """A kind of motion or call.

    Attributes:
        title: as the page has it.
        led: it is led over a link, so that the robot brakes when this computer is gone.
        called: what becomes of it if it is called while the controller is suspended.
        by_api: the same on PolyScope X, where that is something else.
        within: s of the robot's time in which it comes to rest, where it brakes.
        lasts: it is under way for some time.
        since: the firmware that has it.
    """

    title: str
    led: bool = False
    called: str = NOT
    by_api: str = ""
    within: float = 1.5
    lasts: bool = True
    since: Since = _ALWAYS

    def becomes(self, column: str, firmware: str) -> str:
        """What is in its cell; empty where there is no such case."""
        if column == CALLED:
            return self.by_api if self.by_api and Firmware.parse(firmware) in _X else self.called
        if not self.lasts:
            return ""
        if column == "reboot":
            return ENDS
        return BRAKES if self.led else GOES_ON


_CB3, _REGISTERS, _E = Since("3.0"), Since("3.9/5.3"), Since("5.10")

#: name, by which `client.py` begins it -> row
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
    "interpreter": Row("`interpreter.execute`", called=BACK, since=_E),
    # The Robot API is asked first whether the program is paused.
    "dashboard_play": Row("`robot.dashboard.play`, also by the Robot API", called=BACK, by_api=NOT),
    "gripper": Row("`robot.gripper.move`, `set`", called=BACK, lasts=False),
    "urx": Row("`urlink.compat.urx`: `movej`"),
    "ur_rtde": Row("`urlink.compat`: `moveJ`", since=_REGISTERS),
    "ur_rtde_speed": Row("`urlink.compat`: `speedJ`", led=True, since=_REGISTERS),
    "send_line": Row("`robot.script.send_line`", called=LATE),
    "secondary": Row("`robot.script.run` with a `sec`", called=LATE, lasts=False),
    "power_on": Row("`robot.dashboard.power_on`, also by the Robot API", called=LATE, lasts=False),
    "brake_release": Row("`robot.dashboard.brake_release`, also by the Robot API", called=LATE, lasts=False),
}


def firmwares(name: str) -> list[str]:
    """Those that have this row."""
    return [each for each in FIRMWARES if Firmware.parse(each) in ROWS[name].since]


def cells() -> Iterator[tuple[str, str, str]]:
    """(firmware, row, column) of each case."""
    for name, row in ROWS.items():
        for column in COLUMNS:
            for firmware in firmwares(name):
                if row.becomes(column, firmware):
                    yield firmware, name, column


def drawn() -> str:
    """The table as Markdown; what becomes the same everywhere is one row."""
    heads = ("under way, and then:", *UNDER_WAY, "controller suspended, and then called")
    titles: dict[tuple[str, ...], list[str]] = {}
    for name, row in ROWS.items():
        having = firmwares(name)
        title = row.title if len(having) == len(FIRMWARES) else f"{row.title} ({', '.join(having)})"
        each = [dict.fromkeys(row.becomes(column, firmware) or "-" for firmware in having) for column in COLUMNS]
        titles.setdefault(tuple(map(" or ".join, each)), []).append(title)
    lines = [f"| {' | '.join(heads)} |", "|" + " --- |" * len(heads)]
    lines += [f"| {' | '.join(('; '.join(alike), *what))} |" for what, alike in titles.items()]
    return "\n".join(lines) + "\n"


def page(text: str) -> str:
    """The page with this table in its place."""
    changed, count = _BETWEEN.subn(lambda _: drawn(), text)
    assert count == 1, "docs/reliability.md has no place for the table"
    return changed


if __name__ == "__main__":
    _PAGE.write_text(page(_PAGE.read_text(encoding="utf-8")), encoding="utf-8")

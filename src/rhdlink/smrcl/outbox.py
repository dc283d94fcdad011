"""The output of a mission: what it prints in a cycle, in its order, and its log (`log`, `control`), a row for each."""

from __future__ import annotations

import enum
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

from .arithmetic import format_number
from .plan import PlanLine

__all__ = ["DataLog", "Outbox", "Recipient", "Said", "SaidKind"]

#: Messages of one cycle that are kept; a script can print 20000.
_MOST = 50_000


class SaidKind(enum.Enum):
    """The kind of an output."""

    #: A line is about to be executed.
    LINE = "line"
    #: The values of `eval`.
    VALUES = "values"
    #: What a command or an error has to say, for whoever reads along.
    MESSAGE = "message"
    #: `print` and `read`, without a client.
    TEXT = "text"
    #: `putevent`, `syncevent`, a watch, or the status of motion control, without a client.
    EVENT = "event"
    #: `stream`, without a client.
    STREAM = "stream"
    #: `control "savelog"`: the name, and the text behind a line feed.
    LOG = "log"


@dataclass(frozen=True)
class Said:
    """One output of a mission.

    Attributes:
        kind: what it is.
        text: in words. A line and values end with a line feed, a message as MRC prints it.
        number: of a line: how many have been executed; else 0.
        line: of a line: where it stands in the file; else 0.
    """

    kind: SaidKind
    text: str
    number: int = 0
    line: int = 0

    @property
    def printed(self) -> str:
        """As MRC prints it; "" for what it does not print."""
        if self.kind is SaidKind.LINE:
            return f"Line no {self.number:3d}:   {self.text} \n"
        return self.text if self.kind in (SaidKind.VALUES, SaidKind.MESSAGE) else ""


class Recipient(Protocol):
    """Receives what a script says to its client: the session of the client that sent the command, or an `Outbox`."""

    @property
    def can_answer(self) -> bool:
        """It can send a line for `read`."""

    def text(self, text: str) -> None:
        """`print`, `read`."""

    def user_event(self, name: str) -> None:
        """`putevent`."""

    def sync_event(self, name: str) -> None:
        """`syncevent`."""

    def set_xml(self, is_on: bool) -> None:
        """``set "xmlon"``."""

    def stream(self, period: int, variables: Sequence[tuple[str, int]]) -> None:
        """`stream`: names, and places in the pool."""

    def save_log(self, name: str, text: str) -> None:
        """`control "savelog"`."""


class Outbox:
    """Collects the output of the interpreter; it takes the place of a client where there is none."""

    def __init__(self) -> None:
        self._said: list[Said] = []
        self._streamed = 0

    def take(self) -> list[Said]:
        """The output since the last call."""
        said, self._said = self._said, []
        return said

    def _add(self, kind: SaidKind, text: str, number: int = 0, line: int = 0) -> None:
        if len(self._said) < _MOST:
            self._said.append(Said(kind, text, number, line))

    # -- of the interpreter ---------------------------------------------------------------------------------

    def line(self, number: int, line: PlanLine) -> None:
        """A line is about to be executed."""
        self._add(SaidKind.LINE, line.text, number, line.number)

    def values(self, text: str) -> None:
        """The values of `eval`."""
        self._add(SaidKind.VALUES, text)

    def message(self, text: str) -> None:
        """What a command, or an error, has to say."""
        self._add(SaidKind.MESSAGE, text)

    # -- Recipient ------------------------------------------------------------------------------------

    @property
    def can_answer(self) -> bool:
        """There is no client."""
        return False

    def text(self, text: str) -> None:
        """`print`, `read`."""
        self._add(SaidKind.TEXT, text)

    def user_event(self, name: str) -> None:
        """`putevent`."""
        self._add(SaidKind.EVENT, f"userevent {name}")

    def sync_event(self, name: str) -> None:
        """`syncevent`."""
        self._add(SaidKind.EVENT, f"syncevent {name}")

    def event(self, text: str) -> None:
        """A watch, or the status of motion control."""
        self._add(SaidKind.EVENT, text)

    def set_xml(self, is_on: bool) -> None:
        """Without effect: there is no client to send XML to."""

    def stream(self, period: int, variables: Sequence[tuple[str, int]]) -> None:
        """Not sent, since there is no client; MRC prints each variable that was asked for."""
        for each in variables:
            self._streamed += 1
            self.message(f"streamvar {each[0]} {self._streamed} \n")

    def save_log(self, name: str, text: str) -> None:
        """`control "savelog"`."""
        self._add(SaidKind.LOG, f"{name}\n{text}")


class DataLog:
    """Rows of numbers.

    A column belongs to a variable by its number only: when variables are removed and others added, the rows before keep
    the numbers of the old ones, as in MRC. `reset` before that.

    Attributes:
        is_on: whether rows are added.
    """

    #: Rows and columns, as in MRC.
    MOST_ROWS, MOST_COLUMNS = 100_000, 50

    def __init__(self, pool: Sequence[float]) -> None:
        self._pool = pool
        self._places: list[int] = []
        self._rows: list[list[float]] = []
        self._count = 0
        self.is_on = True

    def __len__(self) -> int:
        return self._count

    @property
    def columns(self) -> int:
        """Variables that are logged."""
        return len(self._places)

    def add(self, place: int) -> bool:
        """Log a value of the pool; False if there is no column left."""
        if len(self._places) >= self.MOST_COLUMNS:
            return False
        self._places.append(place)
        return True

    def remove_all(self) -> None:
        """Log nothing; the rows stay."""
        self._places.clear()

    def reset(self) -> None:
        """Forget the rows."""
        self._count = 0

    def update(self) -> None:
        """Add a row for this cycle."""
        if not (self.is_on and self._places) or self._count >= self.MOST_ROWS:
            return
        pool = self._pool
        values = [pool[place] for place in self._places]
        if self._count < len(self._rows):
            self._rows[self._count][: len(values)] = values
        else:
            self._rows.append(values)
        self._count += 1

    @property
    def rows(self) -> list[list[float]]:
        """The rows, each as long as there are variables now."""
        columns = len(self._places)
        return [
            (row + [0.0] * (columns - len(row)))[:columns] if len(row) != columns else row
            for row in self._rows[: self._count]
        ]

    @property
    def text(self) -> str:
        """The rows as MRC writes them to a file: each number is followed by a blank."""
        return "".join("".join(f"{format_number(value)} " for value in row) + "\n" for row in self.rows)

"""A script as the interpreter sees it: its lines and labels, and an execution of it."""

from __future__ import annotations

import enum
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

#: Characters of a line. MRC cuts longer ones, and takes the rest for the next line.
LONGEST_LINE = 255

#: Where MRC finds labels: in lines that begin with the word, the letters and digits behind the first quotation mark.
_LABEL = re.compile(r'label[^"]*"([A-Za-z0-9]*)')


@dataclass
class PlanLine:
    """One line.

    Attributes:
        text: without leading blanks; of a file with the line feed at its end.
        number: of the file, from 1.
        indent: blanks that were before it there.
        steps: what it says, once it has been read; compiled by the interpreter that executes it, see `compile_line`.
    """

    text: str
    number: int
    indent: int = 0
    steps: Sequence[tuple[int, Callable[..., Any]]] | None = field(default=None, repr=False)


class MissionPlan:
    """Lines, and the one that comes next.

    Args:
        lines: texts with their numbers.
        name: of the script.

    Attributes:
        lines: all of them.
        next: index of the one that comes next.
        labels: index of the line of each label; of several lines with the same one the first counts.
    """

    def __init__(self, lines: Iterable[PlanLine], name: str = "") -> None:
        self.name = name
        self.lines: list[PlanLine] = []
        self.next = 0
        self.labels: dict[str, int] = {}
        for line in lines:
            self.append(line)

    def append(self, line: PlanLine) -> None:
        """Add a line at the end."""
        found = _LABEL.match(line.text)
        if found is not None:
            self.labels.setdefault(found.group(1), len(self.lines))
        self.lines.append(line)


def split_lines(source: str, *, cuts: bool) -> Iterator[PlanLine]:
    """The lines of a file.

    Args:
        source: its text.
        cuts: cut lines after 255 characters, as MRC does; without it they are left as they are.
    """
    *lines, last = source.split("\n")
    texts = [f"{text}\n" for text in lines] + [last] * bool(last)
    for number, text in enumerate(texts, start=1):
        size = LONGEST_LINE if cuts else len(text)
        for begin in range(0, len(text), size):
            whole = text[begin : begin + size]
            stripped = whole.lstrip(" \t")
            yield PlanLine(stripped, number, len(whole) - len(stripped))


class Outcome(enum.Enum):
    """How a line goes on."""

    #: The line takes time: it is over when its end or a condition is true.
    WAIT = 0
    #: The next line follows in the same cycle.
    NEXT = 1


@dataclass(frozen=True)
class Failure:
    """Why a plan has failed.

    Attributes:
        reason: in words.
        line: of the file, from 1; 0 where no line is at fault.
        column: from 1; 0 where no line is at fault.
        text: of the line.
        is_limit: a bound was reached.
    """

    reason: str
    line: int
    column: int
    text: str
    is_limit: bool = False


class Stage(enum.Enum):
    """The step of a run in its next cycle."""

    FETCH = "reads lines"
    WAIT = "tests the end of a line"
    ROUTINE = "goes through a routine of a command"
    HOLD = "stands at a breakpoint"
    DONE = "is over"


#: What a run leaves as its result; otherwise 0 for a default end, or the number of the condition that was true.
FREE_LINE, ERROR = -2.0, -1.0


class Run:
    """One execution of a plan.

    Args:
        plan: what is executed.
        result: what is left there until a line has a result.

    Attributes:
        plan: what is executed; `goto` moves in it.
        line: the line that is executed.
        column: in it, from 1: of the statement that is executed.
        result: of the last line: 0 for its default end, the number of a condition, `FREE_LINE` or `ERROR`.
        failure: why it ended early; None if it did not.
    """

    def __init__(self, plan: MissionPlan, result: float = 0.0) -> None:
        self.plan = plan
        self.line: PlanLine | None = None
        self.column = 0
        self.result = result
        self.failure: Failure | None = None
        self.stage = Stage.FETCH
        self._entered: Stage | None = None
        self.cycles = 0
        self.start_distance = 0.0
        self.calls: list[int] = []
        self._routine: Callable[[int], bool] | None = None

    def start_routine(self, routine: Callable[[int], bool]) -> None:
        """Go through a routine from the next cycle on; it is given the number of the cycle and says when it is over."""
        self._routine = routine
        self.stage = Stage.ROUTINE

    def continue_routine(self) -> None:
        """One cycle of the routine."""
        if self._routine is None or self._routine(self.cycles):
            self.stage = Stage.FETCH

    def enter(self, distance: float, cycles: int) -> None:
        """Begin a cycle, `cycles` periods after the one before; distance and time count from the first of a stage."""
        if self.stage is not self._entered:
            self._entered = self.stage
            self.cycles = 0
            self.start_distance = distance
        else:
            self.cycles += cycles

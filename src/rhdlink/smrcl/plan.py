"""Plan of a script for the interpreter (lines and labels), and one execution of a plan."""

from __future__ import annotations

import enum
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

#: Maximum number of characters of a line. MRC splits longer lines, and reads the rest as the next line.
LONGEST_LINE = 255

#: Pattern of MRC's labels: in a line that begins with `label`, the letters and digits after the first quotation mark.
_LABEL = re.compile(r'label[^"]*"([A-Za-z0-9]*)')


@dataclass
class PlanLine:
    """Line of a plan.

    Attributes:
        text: Text without leading blanks. In a file it includes the line feed.
        number: Line number in the file, counted from 1.
        indent: Number of blanks before the text in the file.
        steps: Compiled steps of the line, made by the interpreter at the first execution; see `compile_line`.
    """

    text: str
    number: int
    indent: int = 0
    steps: Sequence[tuple[int, Callable[..., Any]]] | None = field(default=None, repr=False)


class MissionPlan:
    """Lines of a script, and the position of the next line.

    Args:
        lines: Lines with their numbers.
        name: Name of the script.

    Attributes:
        lines: All lines.
        next: Index of the next line.
        labels: Index of the line of each label. If several lines have the same label, the first one counts.
    """

    def __init__(self, lines: Iterable[PlanLine], name: str = "") -> None:
        self.name = name
        self.lines: list[PlanLine] = []
        self.next = 0
        self.labels: dict[str, int] = {}
        for line in lines:
            self.append(line)

    def append(self, line: PlanLine) -> None:
        """Append a line."""
        found = _LABEL.match(line.text)
        if found is not None:
            self.labels.setdefault(found.group(1), len(self.lines))
        self.lines.append(line)


def split_lines(source: str, *, cuts: bool) -> Iterator[PlanLine]:
    """Split a file into lines.

    Args:
        source: Text of the file.
        cuts: Whether to cut lines after 255 characters, as MRC does; otherwise lines have any length.
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
    """Next step after a line: wait, or continue with the next line."""

    #: The line takes time: it ends when its default end or a stop condition is true.
    WAIT = 0
    #: The next line follows in the same cycle.
    NEXT = 1


@dataclass(frozen=True)
class Failure:
    """Failure of a plan.

    Attributes:
        reason: Description of the error.
        line: Line in the file, counted from 1; 0 if no line caused the error.
        column: Column in the line, counted from 1; 0 if no line caused the error.
        text: Text of the line.
        is_limit: Whether a limit was reached.
    """

    reason: str
    line: int
    column: int
    text: str
    is_limit: bool = False


class Stage(enum.Enum):
    """Action of a run in its next cycle."""

    FETCH = "reads lines"
    WAIT = "tests the end of a line"
    ROUTINE = "executes a routine of a command"
    HOLD = "is held at a breakpoint"
    DONE = "has ended"


#: Special results of a run. Otherwise the result is 0 for a default end, or the number of the condition that was true.
FREE_LINE, ERROR = -2.0, -1.0


class Run:
    """Execution of a plan.

    Args:
        plan: Plan to execute.
        result: Initial result, until a line has a result.

    Attributes:
        plan: Plan that is executed; `goto` changes its next line.
        line: Current line.
        column: Column of the current statement in the line, counted from 1.
        result: Result of the last line: 0 for its default end, the number of a condition, `FREE_LINE` or `ERROR`.
        failure: Failure that ended the run early; None if there was none.
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
        """Start a routine in the next cycle.

        The routine is called with the number of the cycle, and returns whether it has ended.
        """
        self._routine = routine
        self.stage = Stage.ROUTINE

    def continue_routine(self) -> None:
        """Perform one cycle of the routine."""
        if self._routine is None or self._routine(self.cycles):
            self.stage = Stage.FETCH

    def enter(self, distance: float, cycles: int) -> None:
        """Begin a cycle, `cycles` periods after the last one.

        Distance and time count from the first cycle of a stage.
        """
        if self.stage is not self._entered:
            self._entered = self.stage
            self.cycles = 0
            self.start_distance = distance
        else:
            self.cycles += cycles

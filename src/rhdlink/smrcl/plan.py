"""A script as the interpreter sees it: its lines, where it is in them, and its labels."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

from .syntax import ScriptLine

__all__ = ["LONGEST_LINE", "MissionPlan", "PlanLine", "split_lines"]

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
        tree: what it says, once it has been read.
        steps: that compiled, by the interpreter that executes it.
    """

    text: str
    number: int
    indent: int = 0
    tree: ScriptLine | None = None
    steps: tuple[Callable[..., Any], ...] | None = field(default=None, repr=False)


class MissionPlan:
    """Lines, and the one that comes next.

    Args:
        lines: texts with their numbers.
        name: of the script.

    Attributes:
        lines: all of them.
        next: index of the one that comes next.
    """

    def __init__(self, lines: Sequence[PlanLine], name: str = "") -> None:
        self.name = name
        self.lines = list(lines)
        self.next = 0
        self._labels: dict[str, int] = {}
        for index, line in enumerate(self.lines):
            self._note_label(index, line)

    def append(self, line: PlanLine) -> None:
        """Add a line at the end."""
        self.lines.append(line)
        self._note_label(len(self.lines) - 1, line)

    def _note_label(self, index: int, line: PlanLine) -> None:
        found = _LABEL.match(line.text)
        if found is not None:
            self._labels.setdefault(found.group(1), index)

    @property
    def labels(self) -> int:
        """How many labels there are."""
        return len(self._labels)

    def find_label(self, label: str) -> int | None:
        """Index of the line with a label; None if there is none. Of several the first counts."""
        return self._labels.get(label)


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

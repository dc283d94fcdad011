"""From the lines that a client sends to whole programs.

A program begins with `def` or `sec` in the first column and ends with `end` in the first column, as the vendor's script
manual has it; every other line is a program by itself, unless there is nothing in it but a comment.
"""

from __future__ import annotations

import re

__all__ = ["Assembler"]

#: Characters of a program; with more it is thrown away, to its `end`. The interpreter takes fewer, and says so.
LONGEST_PROGRAM = 1 << 20

_BEGIN = re.compile(r"(?:def|sec)\b")
_END = re.compile(r"end\b\s*(?:#.*)?$")
_NOTHING = re.compile(r"\s*(?:#.*)?$")


class Assembler:
    """The lines of one client.

    Attributes:
        refused: characters of programs that were too long.
    """

    def __init__(self) -> None:
        self.refused = 0
        self._lines: list[str] = []
        self._length = 0

    def feed(self, line: str) -> str | None:
        """The program that this line completes, if it does."""
        if not self._length and not _BEGIN.match(line):
            return None if _NOTHING.match(line) else line
        self._length += len(line) + 1
        if self._length <= LONGEST_PROGRAM:
            self._lines.append(line)
        else:
            self._lines.clear()
        if not _END.match(line):
            return None
        lines, length = self._lines, self._length
        self._lines, self._length = [], 0
        if length > LONGEST_PROGRAM:
            self.refused += length
            return None
        return "\n".join(lines) + "\n"

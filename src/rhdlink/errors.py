"""The exceptions of a robot and of missions, in addition to those of any peer.

Branches of the tree in `linkcore.errors`::

    LinkError
    ├── LocalError
    │   ├── NotThere            an optional variable that this robot lacks        (AttributeError)
    │   ├── BadMission          the script cannot be run: every mistake in it, with line and column
    │   └── MissionFailed       a mission ended because of a line that could not be executed
    │       └── MissionLimit    a bound that keeps a mission from running away
    └── RemoteError
        ├── AccessDenied        the robot has a master already                    (PermissionError)
        └── WrongVariables      the robot's variables are not those declared
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from linkcore.errors import LocalError, RemoteError

__all__ = ["AccessDenied", "BadMission", "MissionFailed", "MissionLimit", "Mistake", "NotThere", "WrongVariables"]


class NotThere(LocalError, AttributeError):
    """An optional variable that this robot lacks, or a name that it does not know."""


class AccessDenied(RemoteError, PermissionError):
    """Write access was refused, or a variable was set without it."""


class WrongVariables(RemoteError):
    """The robot lacks variables that were declared, or has them in another length or direction.

    Attributes:
        differences: one sentence for each.
    """

    def __init__(self, differences: Sequence[str]) -> None:
        self.differences = tuple(differences)
        super().__init__("the robot's variables are not those declared: " + "; ".join(self.differences))


@dataclass(frozen=True)
class Mistake:
    """Something in a script that cannot work.

    Attributes:
        line: of the file, from 1.
        column: from 1.
        message: what is wrong, and what was expected.
    """

    line: int
    column: int
    message: str

    def __str__(self) -> str:
        return f"line {self.line}, column {self.column}: {self.message}"


class BadMission(LocalError, ValueError):
    """A script that cannot be run.

    Attributes:
        source: name of the script.
        mistakes: all of them, in the order of the file.
    """

    def __init__(self, source: str, mistakes: Sequence[Mistake]) -> None:
        self.source = source
        self.mistakes = tuple(mistakes)
        super().__init__("; ".join(f"{source}: {mistake}" for mistake in self.mistakes))


class MissionFailed(LocalError):
    """A mission ended because of a line that could not be executed, or of something that it needs and has not.

    Attributes:
        line: of the file, from 1; 0 where no line is at fault.
        column: from 1; 0 where no line is at fault.
        text: of the line.
        reason: what was wrong.
    """

    def __init__(self, reason: str, line: int = 0, text: str = "", column: int = 0) -> None:
        self.reason = reason
        self.line = line
        self.column = column
        self.text = text.strip()
        super().__init__(f"line {line}, column {column} ({self.text}): {reason}" if line else reason)


class MissionLimit(MissionFailed):
    """A mission went beyond a bound: an endless loop that takes no time, calls within calls, too many values."""

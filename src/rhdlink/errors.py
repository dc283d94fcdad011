"""Exceptions for robots and missions, in addition to the exceptions in `linkcore.errors`.

Branches of the tree in `linkcore.errors`::

    LinkError
    ├── LocalError
    │   ├── NotThere            the robot lacks this optional variable            (AttributeError)
    │   ├── BadMission          the script cannot be run; lists every mistake with line and column
    │   └── MissionFailed       a mission ended because a line could not be executed
    │       └── MissionLimit    a mission exceeded a limit that stops runaway scripts
    └── RemoteError
        ├── AccessDenied        the robot already has a master                    (PermissionError)
        └── WrongVariables      the robot's variables do not match the declared ones
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from linkcore.errors import LocalError, RemoteError

__all__ = ["AccessDenied", "BadMission", "MissionFailed", "MissionLimit", "Mistake", "NotThere", "WrongVariables"]


class NotThere(LocalError, AttributeError):
    """The robot lacks this optional variable, or no variable has this name."""


class AccessDenied(RemoteError, PermissionError):
    """The robot refused write access, or a variable was set without write access."""


class WrongVariables(RemoteError):
    """The robot lacks declared variables, or has them with another length or direction.

    Attributes:
        differences: Differences from the declaration, one sentence each.
    """

    def __init__(self, differences: Sequence[str]) -> None:
        self.differences = tuple(differences)
        super().__init__("the robot's variables do not match the declared ones: " + "; ".join(self.differences))


@dataclass(frozen=True)
class Mistake:
    """Mistake in a mission script.

    Attributes:
        line: Line in the file, counted from 1.
        column: Column in the line, counted from 1.
        message: Description of the error and of the expected text.
    """

    line: int
    column: int
    message: str

    def __str__(self) -> str:
        return f"line {self.line}, column {self.column}: {self.message}"


class BadMission(LocalError, ValueError):
    """A mission script cannot be run.

    Attributes:
        source: Name of the script.
        mistakes: All mistakes, in the order of the file.
    """

    def __init__(self, source: str, mistakes: Sequence[Mistake]) -> None:
        self.source = source
        self.mistakes = tuple(mistakes)
        super().__init__("; ".join(f"{source}: {mistake}" for mistake in self.mistakes))


class MissionFailed(LocalError):
    """A mission ended because a line failed, or because something that the mission needs is missing.

    Attributes:
        line: Line in the file, counted from 1; 0 if no line caused the error.
        column: Column in the line, counted from 1; 0 if no line caused the error.
        text: Text of the line.
        reason: Description of the error.
    """

    def __init__(self, reason: str, line: int = 0, text: str = "", column: int = 0) -> None:
        self.reason = reason
        self.line = line
        self.column = column
        self.text = text.strip()
        super().__init__(f"line {line}, column {column} ({self.text}): {reason}" if line else reason)


class MissionLimit(MissionFailed):
    """A mission exceeded a limit.

    Examples are an endless loop that takes no time, nested calls, or too many values.
    """

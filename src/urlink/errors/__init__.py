"""Errors that a command to a robot can raise.

The errors belong to two branches of `linkcore.errors`::

    LinkError
    ├── LocalError                  an error in your program
    │   ├── LimitExceeded           a command would exceed a limit of the session; nothing was sent
    │   └── NotOffered              a call of another client library that `urlink.compat` lacks
    └── RemoteError                 the peer sent invalid data, disconnected, or refused
        ├── SafetyStop              a stop is active, or occurred during the motion; `cause` names it
        │   └── NotEnabled          nothing blocks the arm, but `safety.enable()` must be called first
        ├── NotRunning              the robot is not running, or its mode is unknown; nothing was sent
        ├── NotConfirmed            a setting was sent, but the robot's states do not show it
        ├── ToleranceExceeded       the arm left its path, or did not reach its goal
        ├── NoContact               a move until contact ended without a contact
        ├── ScriptError             the controller reports an error in a program: `line`, `column`, `text`
        │   ├── CompileError        the program did not start
        │   └── ScriptFailed        the program failed while it ran
        ├── StatementDiscarded      interpreter mode rejected a statement: `statement`, `number`
        └── ProgramStopped          stopped by the pendant, the dashboard, or another client's program
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from linkcore.errors import LocalError, RemoteError

if TYPE_CHECKING:
    from .stop_explanation import StopExplanation


class NotOffered(LocalError, NotImplementedError):
    """Error: `urlink.compat` lacks a call of another client library. The message names the replacement."""


class LimitExceeded(LocalError):
    """A command would exceed a limit of the session (`connect(limits=)`). Nothing was sent.

    If a watched motion comes too close to a limit while it runs, this error ends the motion, and the arm brakes.

    Attributes:
        limit: Name of the limit: "tool_speed", "joint_speed", "box", "speed_slider", "allowed", or "start".
        value: Description of the command, with the value that would exceed the limit.
        expected: Description of the expected values.
    """

    def __init__(self, limit: str, value: str, expected: str) -> None:
        super().__init__(limit, value, expected)
        self.limit = limit
        self.value = value
        self.expected = expected

    def __str__(self) -> str:
        return f"{self.value}; expected {self.expected} (limit {self.limit!r} of this session)"


class SafetyStop(RemoteError):
    """A stop has ended all motions and blocks new ones.

    Attributes:
        cause: Name of the stop, such as "protective stop".
    """

    def __init__(self, text: str, cause: str, explain: Callable[[], StopExplanation] | None = None) -> None:
        super().__init__(text, cause)
        self.cause = cause
        self._explain = explain

    @property
    def explanation(self) -> StopExplanation | None:
        """Why the robot stopped, from the data of the last seconds; None if this error contains no data.

        The controller reports its code up to a second after the stop. Until then, the explanation can change. To wait
        for the code, use `robot.safety.explain()`. The explanation is lost when the error is pickled.
        """
        return None if self._explain is None else self._explain()

    def __copy__(self) -> SafetyStop:
        copied = type(self)(*self.args)
        copied.__dict__.update(self.__dict__)
        return copied

    def __reduce__(self) -> tuple[type[SafetyStop], tuple[object, ...]]:
        return type(self), self.args

    def __str__(self) -> str:
        return str(self.args[0])


class NotEnabled(SafetyStop):
    """The enable policy requires a call of `safety.enable()` before the arm can move. No stop is active."""


class NotRunning(RemoteError):
    """The robot mode is not RUNNING, or is unknown. Nothing was sent."""


class NotConfirmed(RemoteError):
    """A setting was sent, but the robot's states did not show it in time. The setting might still take effect."""


class ToleranceExceeded(RemoteError):
    """The arm was further from its trajectory than the tolerance allows."""


class NoContact(RemoteError):
    """A move until contact covered its whole distance without a contact. The arm is at rest."""


class ScriptError(RemoteError):
    """The controller reports an error in a program.

    Attributes:
        line: Line number in the source text that your program passed, counted from 1.
        column: Column in that line, as the controller counts.
        text: Error text of the controller, such as "compile_error_name_not_found:txtmsg:".
    """

    def __init__(self, line: int, column: int, text: str) -> None:
        super().__init__(line, column, text)
        self.line = line
        self.column = column
        self.text = text

    def __str__(self) -> str:
        return f"line {self.line}, column {self.column}: {self.text}"


class CompileError(ScriptError):
    """The program does not compile, so it did not start."""


class ScriptFailed(ScriptError):
    """The program failed while it ran."""


class StatementDiscarded(RemoteError):
    """Interpreter mode rejected a statement: it does not compile, or no program is in interpreter mode.

    Attributes:
        statement: Text of the statement, as it was sent.
        number: Number that the controller assigned to the statement.
    """

    def __init__(self, statement: str, number: int) -> None:
        super().__init__(statement, number)
        self.statement = statement
        self.number = number

    def __str__(self) -> str:
        return f"the controller discarded statement {self.number}, because it does not compile: {self.statement!r}"


class ProgramStopped(RemoteError):
    """The program was stopped early: at the pendant, by the dashboard, or by another client's program."""

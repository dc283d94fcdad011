"""The exceptions of commanding a robot: the part of the error tree that is specific to arms.

They hang below two branches of `linkcore.errors`::

    LinkError
    ├── LocalError                  wrong in this program
    │   └── NotOffered              a call of another client that `urlink.compat` has not
    └── RemoteError                 the peer sent nonsense, or went away, or refused
        ├── SafetyStop              a stop holds, or came in between: `cause` says which
        │   └── NotEnabled          all is clear, but `safety.enable()` has to be called first
        ├── NotRunning              the robot does not run, or that is not known; nothing was sent
        ├── NotConfirmed            a setting was sent, and the robot's states do not show it
        ├── ToleranceExceeded       the arm left its path, or did not arrive where it should
        ├── NoContact               a movement that was to end at a contact came to its end without one
        ├── ScriptError             the controller complains of a program: `line`, `column`, `text`
        │   ├── CompileError        it did not begin
        │   └── ScriptFailed        it failed while it ran
        ├── StatementDiscarded      interpreter mode does not take a statement: `statement`, `number`
        └── ProgramStopped          stopped from elsewhere: pendant, dashboard, another client's program
"""

from __future__ import annotations

from linkcore.errors import LocalError, RemoteError


class NotOffered(LocalError, NotImplementedError):
    """A call of another client that is not offered here; the message names what replaces it."""


class SafetyStop(RemoteError):
    """A stop ended the motions and refuses new ones.

    Attributes:
        cause: which stop, such as "protective stop".
    """

    def __init__(self, text: str, cause: str) -> None:
        super().__init__(text, cause)
        self.cause = cause

    def __str__(self) -> str:
        return str(self.args[0])


class NotEnabled(SafetyStop):
    """The robot is fine, but by the policy `safety.enable()` has to be called first."""


class NotRunning(RemoteError):
    """The robot mode is not RUNNING, or is not known; nothing was sent."""


class NotConfirmed(RemoteError):
    """A setting was sent, and the robot's states do not show it in time; it may still take effect."""


class ToleranceExceeded(RemoteError):
    """The arm was further from where it should be than the trajectory allows."""


class NoContact(RemoteError):
    """A movement that was to end at a contact went its whole distance without one; the arm stands."""


class ScriptError(RemoteError):
    """The controller complains of a program.

    Attributes:
        line: in the source as it was given, from 1.
        column: in that line, as the controller counts.
        text: the controller's text, such as "compile_error_name_not_found:txtmsg:".
    """

    def __init__(self, line: int, column: int, text: str) -> None:
        super().__init__(line, column, text)
        self.line = line
        self.column = column
        self.text = text

    def __str__(self) -> str:
        return f"line {self.line}, column {self.column}: {self.text}"


class CompileError(ScriptError):
    """The program does not compile; it did not begin."""


class ScriptFailed(ScriptError):
    """The program failed while it ran."""


class StatementDiscarded(RemoteError):
    """Interpreter mode does not take a statement: it does not compile, or no program is in the mode.

    Attributes:
        statement: as it was sent.
        number: that the controller gave it.
    """

    def __init__(self, statement: str, number: int) -> None:
        super().__init__(statement, number)
        self.statement = statement
        self.number = number

    def __str__(self) -> str:
        return f"the controller has discarded statement {self.number}, which does not compile: {self.statement!r}"


class ProgramStopped(RemoteError):
    """The program was stopped before its end: at the pendant, by the dashboard, or by another client's program."""

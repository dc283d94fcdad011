"""Interpreter mode: statements that clients send to a waiting program, and the status of the statements.

The main thread calls `interpreter_mode()` and waits there. Statements are compiled into the scope of the function that
called `interpreter_mode()`. They can use the variables and functions of this function, and variables to which earlier
statements have assigned. The statements run one after the other; each is executed to its end. The source is
docs/protocols/urscript.md, section Interpreter mode. The following is assumed:

- Statement numbers begin with 1 in each program, and discarded statements are counted. Outside of interpreter mode, the
  number is 0.
- At most `MOST` statements are kept until they are cleared. Further statements are discarded. Statements that are
  longer than `LONGEST` are discarded too.
- `clear_interpreter()` clears the statements that have begun, but keeps variables and functions that they have defined.
- `abort` ends every kind of motion that a program waits for.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Generic, NamedTuple, TypeVar

from .errors import ProgramError

#: Maximum number of statements, executed or not, that are kept until they are cleared.
MOST = 1000
#: Maximum number of characters in a statement.
LONGEST = 1 << 13


class StatementReply(NamedTuple):
    """Reply to a client in interpreter mode.

    Attributes:
        word: First word of the reply: ack, discard or state.
        number: Number of the statement, or the queried value.
    """

    word: str
    number: int


S = TypeVar("S")


class StatementQueue(Generic[S]):
    """Queue of the compiled statements of one program, in the order of arrival.

    Attributes:
        is_on: Whether the program is in interpreter mode.
        last_interpreted, last_executed, last_cleared: Highest numbers of an accepted, a begun and a cleared statement;
            0 if there is no such statement.
        aborts: Function that ends the motion for which the program waits.
    """

    def __init__(self) -> None:
        self.is_on = False
        self.last_interpreted = self.last_executed = self.last_cleared = 0
        self.aborts: Callable[[], object] = lambda: None
        self._compile: Callable[[str], S] | None = None
        self._waiting: deque[tuple[int, S]] = deque()
        self._numbers = 0
        self._kept = 0
        self._clears_on_end = True

    # -- for the program -------------------------------------------------------------------------------

    def enter(self, compile_: Callable[[str], S], clear_on_enter: bool, clear_on_end: bool) -> None:
        """Begin interpreter mode. `compile_` compiles a statement, or raises `ProgramError`."""
        self._compile = compile_
        if clear_on_enter:
            self._forget_waiting()
        self._clears_on_end = clear_on_end
        self.is_on = True

    def leave(self) -> None:
        """End interpreter mode."""
        self.is_on = False
        if self._clears_on_end:
            self._forget_waiting()
            self.clear()

    def take(self) -> S | None:
        """Remove and return the next statement, which then counts as begun; None if no statement is queued."""
        if not self._waiting:
            return None
        self.last_executed, statement = self._waiting.popleft()
        return statement

    def clear(self) -> None:
        """Clear the statements that have begun."""
        self.last_cleared = self.last_executed
        self._kept = len(self._waiting)

    def _forget_waiting(self) -> None:
        self._kept -= len(self._waiting)
        self._waiting.clear()

    # -- for clients -----------------------------------------------------------------------------------

    def put(self, text: str) -> StatementReply:
        """Compile and queue a statement, and return the reply to the client."""
        if not self.is_on or self._compile is None:
            return StatementReply("discard", 0)
        self._numbers += 1
        if self._kept >= MOST or len(text) > LONGEST:
            return StatementReply("discard", self._numbers)
        try:
            statement = self._compile(text)
        except ProgramError:
            return StatementReply("discard", self._numbers)
        self.last_interpreted = self._numbers
        self._kept += 1
        self._waiting.append((self._numbers, statement))
        return StatementReply("ack", self._numbers)

    def obey(self, word: str) -> StatementReply | None:
        """Execute a command that is not a statement; return None if `word` is not such a command."""
        if word == "skipbuffer":
            self._forget_waiting()
        elif word == "abort":
            self.aborts()
        elif word == "stateunexecuted":
            return StatementReply("state", len(self._waiting))
        elif word == "statelastinterpreted":
            return StatementReply("state", self.last_interpreted)
        elif word == "statelastcleared":
            return StatementReply("state", self.last_cleared)
        elif word != "statelastexecuted":
            return None
        return StatementReply("state", self.last_executed)

"""Interpreter mode, 30020: takes a URScript statement, and answers with its status.

Assumed: nothing is sent on connecting, statements are discarded in local control, and without a program all numbers
are 0.
"""

from __future__ import annotations

from linkcore.wire.fields import Since

from ..programs.runner import ProgramRunner
from ..state import ControllerState
from ..urscript.statements import StatementQueue, StatementReply
from .interface import Interface, InterfaceClient, LineReceiver

SINCE = Since("5.10")


class InterpreterInterface(Interface):
    """Passes statements to the program that runs.

    Args:
        state: of the controller.
        runner: of its programs.
    """

    def __init__(self, state: ControllerState, runner: ProgramRunner) -> None:
        self._state = state
        self._runner = runner

    def is_offered(self) -> bool:
        return self._state.firmware in SINCE

    def receiver(self, client: InterfaceClient) -> LineReceiver:
        def answer(line: str) -> None:
            reply = self.reply(line)
            if reply:
                client.send(f"{reply}\n".encode())

        return LineReceiver(client, self._state.counters, answer)

    def reply(self, line: str) -> str:
        """The reply to a line, without the line's end; empty for an empty line."""
        # Of the separators of lines only one ends a line on the wire; the others must not look as if they did.
        text = " ".join(line.splitlines()).strip()
        if not text:
            return ""
        program = self._runner.program
        statements = StatementQueue() if program is None else program.execution.statements
        found = statements.obey(text)
        if found is None:
            found = StatementReply("discard", 0) if self._state.is_local else statements.put(text)
        return f"{found.word}: {found.number}: {text}"

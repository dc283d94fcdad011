"""Interpreter mode, port 30020, which accepts URScript statements and replies with their status.

Three things are assumed. Nothing is sent at the beginning of a connection. In local control, statements are discarded.
If no program runs, all numbers in replies are 0.
"""

from __future__ import annotations

from linkcore.wire.fields import Since

from ..programs.runner import ProgramRunner
from ..state import ControllerState
from ..urscript.statements import StatementQueue, StatementReply
from .interface import Interface, InterfaceClient, LineReceiver

SINCE = Since("5.10")


class InterpreterInterface(Interface):
    """Interpreter mode of one controller, which passes statements to the running program.

    Args:
        state: State of the controller.
        runner: Runner of its programs.
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
        """Return the reply to a line, without a line ending. The reply to an empty line is empty."""
        # Only a newline ends a line on the wire. Replace all other line separators, so that the reply is one line.
        text = " ".join(line.splitlines()).strip()
        if not text:
            return ""
        program = self._runner.program
        statements = StatementQueue() if program is None else program.execution.statements
        found = statements.obey(text)
        if found is None:
            found = StatementReply("discard", 0) if self._state.is_local else statements.put(text)
        return f"{found.word}: {found.number}: {text}"

"""Interpreter mode of a simulated controller (port 30020): a statement in, and a line out with its status.

Guesses: that nothing is sent on connecting, that statements are discarded in local control, and that without a program
all numbers are 0.
"""

from __future__ import annotations

from linkcore.wire.version import Since

from ..programs.runner import ProgramRunner
from ..state import ControllerState
from ..urscript.statements import Reply, StatementQueue
from .port import AnsweringPort, Client, LineReceiver

__all__ = ["InterpreterPort"]

SINCE = Since("5.10")


class InterpreterPort(AnsweringPort):
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

    def receiver(self, client: Client) -> LineReceiver:
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
        statements = self._runner.statements or StatementQueue()
        found = statements.obey(text)
        if found is None:
            is_local = self._state.firmware.is_e_series and not self._state.remote_control
            found = Reply("discard", 0) if is_local else statements.put(text)
        return f"{found.word}: {found.number}: {text}"

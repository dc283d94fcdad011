"""The ports that answer a line with a line: interpreter mode (30020), and the Robotiq URCap (63352).

Interpreter mode takes a statement and answers with its status. Guesses: that nothing is sent on connecting, that
statements are discarded in local control, and that without a program all numbers are 0. The gripper's port answers as
public clients and programs of the URCap expect it: `ack` comes without a newline, a value with one.
"""

from __future__ import annotations

from linkcore.wire.fields import Since

from ..programs.runner import ProgramRunner
from ..robot.gripper import SimulatedGripper
from ..state import ControllerState
from ..urscript.statements import StatementQueue, StatementReply
from .port import AnsweringPort, LineReceiver, PortClient

__all__ = ["GripperPort", "InterpreterPort"]

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

    def receiver(self, client: PortClient) -> LineReceiver:
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
            found = StatementReply("discard", 0) if is_local else statements.put(text)
        return f"{found.word}: {found.number}: {text}"


class GripperPort(AnsweringPort):
    """Serves the gripper of one controller.

    Args:
        state: of the controller.
        gripper: that is mounted; None for no such URCap.
    """

    def __init__(self, state: ControllerState, gripper: SimulatedGripper | None) -> None:
        self._state = state
        self._gripper = gripper

    def is_offered(self) -> bool:
        # URCaps came with CB3.
        return self._gripper is not None and not self._state.firmware.is_cb2

    def receiver(self, client: PortClient) -> LineReceiver:
        gripper = self._gripper
        assert gripper is not None, "the port is not offered without one"

        def answer(line: str) -> None:
            reply = gripper.reply(line)
            if reply is not None:
                client.send(reply.encode("ascii") if reply == "ack" else f"{reply}\n".encode("ascii"))

        return LineReceiver(client, self._state.counters, answer)

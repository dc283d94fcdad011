"""The ports that answer what comes: interpreter mode (30020), the Robotiq URCap (63352), the serial line (54321).

Interpreter mode takes a statement and answers with its status. Guesses: that nothing is sent on connecting, that
statements are discarded in local control, and that without a program all numbers are 0. The gripper's port answers as
public clients and programs of the URCap expect it: `ack` comes without a newline, a value with one. The serial line is
that of the tool connector, as the vendor's URCap forwards it. Guesses: that bytes are lost while the line is not
enabled, that an answer goes to the client that asked, and that bytes take no time on the line. A baud rate other than
that of the device is not noticed.
"""

from __future__ import annotations

from collections.abc import Callable

from linkcore.wire.fields import Since

from ..programs.runner import ProgramRunner
from ..robot.gripper import SimulatedGripper
from ..state import ControllerState
from ..urscript.statements import StatementQueue, StatementReply
from .interface import LineReceiver, Port, PortClient, PortReceiver

SINCE = Since("5.10")


class InterpreterPort(Port):
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
        program = self._runner.program
        statements = StatementQueue() if program is None else program.execution.statements
        found = statements.obey(text)
        if found is None:
            found = StatementReply("discard", 0) if self._state.is_local else statements.put(text)
        return f"{found.word}: {found.number}: {text}"


class GripperPort(Port):
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


#: What is mounted: called with the bytes that come, it returns those that it answers with.
Device = Callable[[bytes], bytes]


class SerialLinePort(Port):
    """Copies bytes between its clients and what is mounted.

    Args:
        state: of the controller.
        device: what is mounted; None for nothing.

    Attributes:
        device: the same; can be set, and is called in the thread of the server.
    """

    def __init__(self, state: ControllerState, device: Device | None) -> None:
        self._state = state
        self.device = device

    def is_offered(self) -> bool:
        return self._state.firmware.is_e_series

    def receiver(self, client: PortClient) -> PortReceiver:
        return _Receiver(self, client)

    def exchange(self, data: bytes) -> bytes:
        """What comes back for bytes that are sent to the line."""
        if self.device is None or not self._state.signals.tool_communication.is_enabled:
            return b""
        return self.device(data)


class _Receiver(PortReceiver):
    def __init__(self, port: SerialLinePort, client: PortClient) -> None:
        self._port = port
        self._client = client

    def feed(self, data: bytes) -> None:
        answer = self._port.exchange(data)
        if answer:
            self._client.send(answer)

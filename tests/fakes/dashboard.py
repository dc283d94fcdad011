"""Dashboard server over TCP that sends the bytes of the test, and a simulated controller that the test steps."""

from __future__ import annotations

import socket
from collections.abc import Callable

from tests.fakes.server import OneAfterAnother
from urlink.protocol.dashboard.commands import GREETING
from urlink.simulator import Controller, Still

#: Time limit for events that must happen at once, in seconds.
TIMEOUT = 10.0

#: One version for each firmware at which the table of commands changes, and some further ones.
FIRMWARES = ["1.6", "1.8", "3.0", "3.1", "3.2", "3.4", "3.7", "3.12", "3.14", "5.0", "5.1", "5.4", "5.6", "5.8", "5.11"]


def stepped(firmware: str) -> Controller:
    """Return a controller that the test steps, with two saved programs and an arm at rest."""
    files = dict.fromkeys(("pick.urp", "/programs/place it.urp"), "while True:\n  sync()\nend\n")
    return Controller(firmware=firmware, motion=Still(), serial="20215500001", files=files)


def wait(host: Controller, seconds: float) -> None:
    host.step(round(seconds * host.firmware.rate))


def protective_stop(host: Controller) -> None:
    host.faults.protective_stop()
    host.step()


def play(host: Controller) -> None:
    """Load and start a program."""
    assert host.pendant.load("pick.urp")
    assert host.pendant.play()


class ScriptedDashboard(OneAfterAnother):
    """Server that sends a greeting and answers each line with `answer`, which is called in the thread of the server.

    Attributes:
        lines: Received lines of all connections.
    """

    #: Results of `answer` that send no reply, and that close the connection.
    SILENCE, CLOSE = b"", None

    def __init__(
        self, answer: Callable[[str], bytes | None], greeting: bytes = GREETING.encode() + b"\n", chunk: int = 1 << 16
    ) -> None:
        self._answer = answer
        self._greeting = greeting
        self._chunk = chunk
        self.lines: list[str] = []
        super().__init__(TIMEOUT)

    def _talk(self, connection: socket.socket) -> None:
        self._send_chunks(connection, self._greeting)
        rest = b""
        while True:
            data = connection.recv(65536)
            if not data:
                return
            *lines, rest = (rest + data).split(b"\n")
            for line in lines:
                self.lines.append(line.decode())
                said = self._answer(line.decode())
                if said is None:
                    return
                self._send_chunks(connection, said)

    def _send_chunks(self, connection: socket.socket, data: bytes) -> None:
        for start in range(0, len(data), self._chunk):
            connection.sendall(data[start : start + self._chunk])

    def send(self, data: bytes) -> None:
        """Send data without a request."""
        assert self._connection is not None
        self._connection.sendall(data)

    def hang_up(self) -> None:
        """Close the current connection."""
        assert self._connection is not None
        self._connection.shutdown(socket.SHUT_RDWR)

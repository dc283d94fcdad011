"""A dashboard server over TCP whose every byte a test decides, and a stand-in for the controller behind it."""

from __future__ import annotations

import contextlib
import socket
import threading
from collections.abc import Callable
from dataclasses import dataclass, field

from urlink.firmware import Firmware
from urlink.interfaces.dashboard.commands import GREETING
from urlink.models import Model, model
from urlink.simulator.modes import Modes, Power

#: Seconds that a test waits for what must come at once.
PATIENCE = 10.0

#: One of each firmware at which the table changes, or was asked to be looked at.
FIRMWARES = ["1.6", "1.8", "3.0", "3.1", "3.2", "3.4", "3.7", "3.12", "3.14", "5.0", "5.1", "5.4", "5.6", "5.8", "5.11"]


@dataclass
class StandIn:
    """A controller with one program, and no arm; it is its own pendant."""

    firmware: Firmware
    modes: Modes
    model: Model
    time: float = 100.0
    stopped_since: float | None = None
    remote_control: bool = True
    loaded: str | None = None
    popup: str | None = None
    log: list[str] = field(default_factory=list)
    serial: str = "20215500001"
    files: tuple[str, ...] = ("pick.urp", "/programs/place it.urp")
    has_program: bool = False
    is_paused: bool = False

    @classmethod
    def of(cls, firmware: str) -> StandIn:
        version = Firmware.parse(firmware)
        return cls(version, Modes(version), model("UR5e" if version.is_e_series else "UR5"))

    @property
    def pendant(self) -> StandIn:
        return self

    def wait(self, seconds: float) -> None:
        self.time += seconds
        for _ in range(round(seconds * 100)):
            self.modes.advance(0.01, True, self.has_program)

    def protective_stop(self) -> None:
        self.modes.protective_stop()
        self.stopped_since = self.time

    def load(self, path: str) -> bool:
        if path not in self.files:
            return False
        self.loaded = path
        return True

    def play(self) -> bool:
        if self.loaded is None or self.modes.power is not Power.RUNNING:
            return False
        return self._set(True)

    def pause(self) -> bool:
        return self.has_program

    def stop(self) -> bool:
        return self.has_program and self._set(False)

    def _set(self, has_program: bool) -> bool:
        self.has_program = has_program
        self.modes.advance(0.0, True, has_program)
        return True


class Desk:
    """Listens, greets, and answers each line as `answer` says, which is called in the desk's thread.

    Attributes:
        lines: what came, connection by connection.
        connections: accepted so far.
    """

    #: what `answer` returns for: nothing is said; the connection is closed; it is reset
    SILENCE, CLOSE = b"", None

    def __init__(
        self, answer: Callable[[str], bytes | None], greeting: bytes = GREETING.encode() + b"\n", chunk: int = 1 << 16
    ) -> None:
        self._answer = answer
        self._greeting = greeting
        self._chunk = chunk
        self.lines: list[str] = []
        self.connections = 0
        self._open: socket.socket | None = None
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port: int = self._listener.getsockname()[1]
        self._thread = threading.Thread(target=self._serve)
        self._thread.start()

    def _serve(self) -> None:
        while True:
            try:
                connection, _ = self._listener.accept()
            except OSError:
                return
            self.connections += 1
            self._open = connection
            with connection, contextlib.suppress(OSError):
                connection.settimeout(PATIENCE)
                self._say(connection, self._greeting)
                self._talk(connection)

    def _talk(self, connection: socket.socket) -> None:
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
                self._say(connection, said)

    def _say(self, connection: socket.socket, data: bytes) -> None:
        for start in range(0, len(data), self._chunk):
            connection.sendall(data[start : start + self._chunk])

    def say(self, data: bytes) -> None:
        """Say something unasked."""
        assert self._open is not None
        self._open.sendall(data)

    def hang_up(self) -> None:
        """Close the connection of the moment."""
        assert self._open is not None
        self._open.shutdown(socket.SHUT_RDWR)

    def close(self) -> None:
        for each in (self._open, self._listener):
            if each is not None:
                with contextlib.suppress(OSError):
                    each.shutdown(socket.SHUT_RDWR)
        self._listener.close()
        self._thread.join(PATIENCE)
        assert not self._thread.is_alive()

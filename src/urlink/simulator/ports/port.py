"""An interface of the controller, as the server that carries its bytes uses it; and the input that several share.

A `Port` is sans-IO. The server asks it in which cycle it has something to send and for the packets, and hands what a
client sends to the `Receiver` that the port has made for this client.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from ..programs.loader import LineAssembler
from ..state import Counters

__all__ = ["AnsweringPort", "Client", "LineReceiver", "Port", "ReadOnlyReceiver", "Receiver", "ScriptReceiver"]

#: Bytes of a line from a client; longer ones are thrown away.
LONGEST_LINE = 1 << 16


class Client(Protocol):
    """One connection, as a port sees it."""

    @property
    def is_open(self) -> bool:
        """The connection is open."""

    @property
    def pending(self) -> int:
        """Bytes that were sent and that the network has not taken yet, since it does not read."""

    def send(self, packet: bytes) -> None:
        """Send a packet or a reply."""

    def finish(self) -> None:
        """Close it, when it has taken what was sent."""

    def drop(self) -> None:
        """Close it now, by a reset."""


class Receiver(Protocol):
    """Takes what one client sends."""

    def feed(self, data: bytes) -> None:
        """Bytes, as they have come."""

    def end(self) -> None:
        """The connection is over."""


class Port(Protocol):
    """One interface of the controller."""

    def is_offered(self) -> bool:
        """The firmware that runs at present has this interface; without it connections are refused."""

    def greeting(self) -> list[bytes]:
        """The packets with which a connection begins."""

    def next_cycle(self, cycle: int) -> int | None:
        """The first cycle after this one in which all clients are sent something; None if that is not known."""

    def packets(self, cycle: int) -> list[bytes]:
        """The packets for all clients in this cycle. Called once in each cycle, while a client is connected.

        A port whose clients are sent different things sends these to each client, and gives nothing back.
        """

    def skip(self) -> None:
        """No client is connected in this cycle: what only these would have been sent is forgotten."""

    def receiver(self, client: Client) -> Receiver:
        """Takes the bytes of a new client."""


class AnsweringPort:
    """Base class of a port whose clients are sent nothing but answers; it adds `receiver`."""

    def is_offered(self) -> bool:
        return True

    def greeting(self) -> list[bytes]:
        return []

    def next_cycle(self, cycle: int) -> int | None:
        return None

    def packets(self, cycle: int) -> list[bytes]:
        return []

    def skip(self) -> None:
        return None


class ReadOnlyReceiver:
    """Of the read-only ports: what comes is counted, and has no effect."""

    def __init__(self, counters: Counters) -> None:
        self._counters = counters

    def feed(self, data: bytes) -> None:
        self._counters.refused_bytes += len(data)

    def end(self) -> None:
        return None


class LineReceiver:
    """Cuts what comes into lines.

    Args:
        client: what comes after it was closed is not looked at.
        counters: where bytes of lines that are too long are counted.
        on_line: called with each line, without its end.
    """

    def __init__(self, client: Client, counters: Counters, on_line: Callable[[str], object]) -> None:
        self._client = client
        self._counters = counters
        self._on_line = on_line
        self._line = bytearray()
        self._is_too_long = False

    def feed(self, data: bytes) -> None:
        *lines, rest = data.split(b"\n")
        for line in lines:
            self._extend(line)
            text = None if self._is_too_long else self._line.decode("utf-8", "backslashreplace").removesuffix("\r")
            self._line.clear()
            self._is_too_long = False
            if text is not None:
                self._on_line(text)
            if not self._client.is_open:
                return
        self._extend(rest)

    def end(self) -> None:
        return None

    def _extend(self, part: bytes) -> None:
        if self._is_too_long or len(self._line) + len(part) > LONGEST_LINE:
            self._counters.refused_bytes += len(self._line) + len(part)
            self._line.clear()
            self._is_too_long = True
        else:
            self._line += part


class ScriptReceiver(LineReceiver):
    """Makes programs of the lines that come: of the primary, secondary and real-time interface.

    Args:
        client: the sender.
        counters: where text that is thrown away is counted.
        on_line: called with each line.
        on_program: called with the text of each whole program; False where it is thrown away.
    """

    def __init__(
        self,
        client: Client,
        counters: Counters,
        on_line: Callable[[str], object],
        on_program: Callable[[str], bool],
    ) -> None:
        super().__init__(client, counters, self._take)
        self._assembler = LineAssembler()
        self._note = on_line
        self._on_program = on_program

    def _take(self, line: str) -> None:
        self._note(line)
        refused = self._assembler.refused
        program = self._assembler.feed(line)
        self._counters.refused_bytes += self._assembler.refused - refused
        if program is not None and not self._on_program(program):
            self._counters.refused_bytes += len(program)

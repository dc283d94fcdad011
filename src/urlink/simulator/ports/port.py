"""An interface of the controller, as the server uses it; and the receivers that several interfaces share.

A `Port` is sans-IO. The server reads from it in which cycle it has something to send, and the packets; and passes what
a client sends to the `Receiver` that the port has made for this client.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from ..programs.loader import LineAssembler
from ..state import Counters

__all__ = ["AnsweringPort", "Client", "LineReceiver", "Port", "ReadOnlyReceiver", "Receiver", "ScriptReceiver"]

#: Bytes of a line from a client; longer ones are discarded.
LONGEST_LINE = 1 << 16


class Client(Protocol):
    """One connection, as a port sees it."""

    @property
    def is_open(self) -> bool:
        """Whether the connection is open."""

    @property
    def pending(self) -> int:
        """Bytes that were sent, but not taken by the network, because the client does not read."""

    def send(self, packet: bytes) -> None:
        """Send a packet or a reply."""

    def finish(self) -> None:
        """Close it when the bytes that were sent have been taken."""

    def drop(self) -> None:
        """Close it now, by a reset."""


class Receiver(Protocol):
    """Receives the bytes of one client."""

    def feed(self, data: bytes) -> None:
        """Handle bytes, as they came."""

    def end(self) -> None:
        """Handle the end of the connection."""


class Port(Protocol):
    """One interface of the controller."""

    def is_offered(self) -> bool:
        """Whether the present firmware has this interface; without it connections are refused."""

    def greeting(self) -> list[bytes]:
        """The packets at the beginning of a connection."""

    def next_cycle(self, cycle: int) -> int | None:
        """The first cycle after this one with packets for all clients; None if that is not known."""

    def packets(self, cycle: int) -> list[bytes]:
        """The packets for all clients in this cycle. Called once in each cycle, while a client is connected.

        If clients are sent different packets, the port sends them itself, and returns none.
        """

    def skip(self) -> None:
        """No client is connected in this cycle: discard what would have been sent in it."""

    def receiver(self, client: Client) -> Receiver:
        """Make the receiver for a new client."""


class AnsweringPort:
    """Base class of a port that only answers its clients; subclasses add `receiver`."""

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
    """The receiver of the read-only ports: bytes are counted, and have no effect."""

    def __init__(self, counters: Counters) -> None:
        self._counters = counters

    def feed(self, data: bytes) -> None:
        self._counters.refused_bytes += len(data)

    def end(self) -> None:
        return None


class LineReceiver:
    """Cuts received bytes into lines.

    Args:
        client: what comes after it was closed is ignored.
        counters: count the bytes of lines that are too long.
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
    """Makes programs of the received lines, for the primary, secondary and real-time interface.

    Args:
        client: the sender.
        counters: count the text that is discarded.
        on_line: called with each line.
        on_program: called with the text of each whole program; returns False if it was discarded.
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

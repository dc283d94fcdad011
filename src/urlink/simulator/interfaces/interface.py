"""An interface of the controller, as the server uses it, and what several interfaces share: receivers and packets.

An `Interface` is sans-IO. The server reads from it in which cycle it has something to send, and the packets; and passes
what a client sends to the `InterfaceReceiver` that the interface has made for this client. A `Form` is a packet laid
out once, by its schema in `urlink.protocol`, and filled in many times: a controller packs hundreds of them a second.
"""

from __future__ import annotations

import struct
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from itertools import groupby
from typing import Any, Protocol

from linkcore.wire.layout import Layout
from urlink.protocol.headers import PACKAGE

from ..programs.loader import LineAssembler
from ..state import Counters

#: Names of fields -> plain numbers, or lists of them.
Fields = Mapping[str, Any]


class Form:
    """A packet of one layout and of fixed size, filled in and packed many times.

    Gives the bytes of `Layout.encode` in a tenth of the time: values stay where they were put, and one `struct` packs
    them. Values are plain numbers and lists of them, checked only by `struct`.
    The first packet has to name every field.
    """

    def __init__(self, layout: Layout) -> None:
        codes: list[str] = [""] * sum(place.count or 1 for place in layout.places.values())
        self._layout: Layout | None = layout  # until the first packet has named every field
        self._values: list[Any] = [0] * len(codes)
        self._at: dict[str, int | slice] = {}
        for name, place in layout.places.items():
            assert place.number is not None, f"{layout.name} is of no fixed size"
            code = place.number.code
            at = self._at[name] = place.at
            if isinstance(at, slice):
                codes[at] = [code] * len(codes[at])
            else:
                codes[at] = code
        packed = "".join(f"{len(list(run))}{code}" for code, run in groupby(codes))
        header = layout.header.pack(**{**layout.constants, "size": layout.size})
        self._struct = struct.Struct(f">{len(header)}s{packed}")
        self._header = header

    def pack(self, fields: Fields) -> bytes:
        """The packet with these fields, others unchanged; fields that are not in the layout are skipped.

        Raises:
            BadValue: this is the first packet, and a field has no value.
        """
        if self._layout is not None:
            self._layout.check_complete(fields.keys())
            self._layout = None
        values, places = self._values, self._at
        for name, value in fields.items():
            at = places.get(name)
            if at is not None:
                values[at] = value
        return self._struct.pack(self._header, *values)


def package(kind: int, body: bytes) -> bytes:
    """A package or sub-package of the primary and secondary interface."""
    return PACKAGE.pack(size=PACKAGE.width + len(body), type=kind) + body


#: Bytes of a line from a client; longer ones are discarded.
LONGEST_LINE = 1 << 16


class InterfaceClient(Protocol):
    """One connection, as an interface sees it."""

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


class InterfaceReceiver(ABC):
    """Receives the bytes of one client."""

    @abstractmethod
    def feed(self, data: bytes) -> None:
        """Handle bytes, as they came."""

    def end(self) -> None:
        """Handle the end of the connection."""
        return None


class Interface(ABC):
    """One interface of the controller. Unless a subclass differs, every firmware has it, and it only answers."""

    def is_offered(self) -> bool:
        """Whether the present firmware has this interface; without it connections are refused."""
        return True

    def greeting(self) -> list[bytes]:
        """The packets at the beginning of a connection."""
        return []

    def next_cycle(self, cycle: int) -> int | None:
        """The first cycle after this one with packets for all clients; None if that is not known."""
        return None

    def packets(self, cycle: int) -> list[bytes]:
        """The packets for all clients that have become due since the last call, as of this cycle.

        Called in each cycle while a client is connected, but for those that are far too late. If clients are sent
        different packets, the interface sends them itself, and returns none.
        """
        return []

    def skip(self) -> None:
        """No client is connected in this cycle: discard what would have been sent in it."""
        return None

    @abstractmethod
    def receiver(self, client: InterfaceClient) -> InterfaceReceiver:
        """Make the receiver for a new client."""


class ReadOnlyReceiver(InterfaceReceiver):
    """The receiver of the read-only ports: bytes are counted, and have no effect."""

    def __init__(self, counters: Counters) -> None:
        self._counters = counters

    def feed(self, data: bytes) -> None:
        self._counters.refused_bytes += len(data)


class LineReceiver(InterfaceReceiver):
    """Cuts received bytes into lines.

    Args:
        client: what comes after it was closed is ignored.
        counters: count the bytes of lines that are too long.
        on_line: called with each line, without its end.
    """

    def __init__(self, client: InterfaceClient, counters: Counters, on_line: Callable[[str], object]) -> None:
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
        client: InterfaceClient,
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

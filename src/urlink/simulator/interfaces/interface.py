"""Base class of the controller's interfaces, and receivers and packets that several interfaces use.

An `Interface` has no sockets (sans-IO). It reports to the server when packets are due, and returns these packets. For
each client, the interface makes an `InterfaceReceiver`, and the server passes the bytes of the client to this receiver.

A `Form` is a packet template. The positions of the fields are computed once, according to the schema in
`urlink.protocol`. Then the template is filled in many times. This saves time, because a controller makes hundreds of
packets per second.
"""

from __future__ import annotations

import struct
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from itertools import groupby
from typing import Any, Generic, Protocol, TypeVar

from linkcore.deferred import Deferred, SteadyBytes
from linkcore.wire.layout import Layout
from urlink.protocol.headers import PACKAGE

from ..programs.loader import LineAssembler
from ..robot.sensors import Samples
from ..state import Counters

L = TypeVar("L", bound=Layout)

#: Field name -> plain number, or list of plain numbers.
Fields = Mapping[str, Any]


class Form(Generic[L]):
    """Template for packets of one layout with a fixed size, which is filled in and packed many times.

    `pack` returns the same bytes as `Layout.encode` in a tenth of the time, because unchanged values are kept and one
    `struct` packs all values. A value is a plain number or a list of plain numbers. Only `struct` checks the values.
    The first packet must contain a value for every field.

    Attributes:
        layout: Layout of the packets.
    """

    def __init__(self, layout: L) -> None:
        codes: list[str] = [""] * sum(place.count or 1 for place in layout.places.values())
        self.layout = layout
        self._is_checked = False  # whether a packet was made, which has a value for every field
        self._values: list[Any] = [0] * len(codes)
        self._at: dict[str, int | slice] = {}
        for name, place in layout.places.items():
            assert place.number is not None, f"{layout.name} has no fixed size"
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
        """Return the packet with these field values.

        Other fields keep their values. Fields that are not in the layout are ignored.

        Raises:
            BadValue: If this is the first packet, and a field has no value.
        """
        if not self._is_checked:
            self.layout.check_complete(fields.keys())
            self._is_checked = True
        values, places = self._values, self._at
        for name, value in fields.items():
            at = places.get(name)
            if at is not None:
                values[at] = value
        return self._struct.pack(self._header, *values)


def package(kind: int, body: bytes) -> bytes:
    """Return a package or sub-package of the primary and secondary interfaces, with its size and type in front."""
    return PACKAGE.pack(size=PACKAGE.width + len(body), type=kind) + body


#: Maximum number of bytes in a line from a client; longer lines are discarded.
LONGEST_LINE = 1 << 16


class InterfaceClient(Protocol):
    """Connection of one client, with the methods that an interface needs."""

    @property
    def is_open(self) -> bool:
        """Whether the connection is open."""

    @property
    def pending(self) -> int:
        """Number of sent bytes that are still buffered because the client has not read them."""

    def send(self, packet: bytes) -> None:
        """Send a packet or a reply."""

    def finish(self) -> None:
        """Close the connection when all sent bytes have left the buffer."""

    def drop(self) -> None:
        """Close the connection now, with a reset."""


class BatchClient(Protocol):
    """Connection of one client, with what an interface needs to send packets before they are due."""

    receiver: InterfaceReceiver

    @property
    def last_quiet_cycle(self) -> int:
        """Last cycle whose packets can be sent now by `send_batch`, before they are due.

        It is later than the current cycle only in simulated time, while nothing else happens, and while the client
        needs no packet at its time.
        """

    def send_batch(self, packets: Sequence[Deferred | SteadyBytes], cycles: Sequence[int]) -> None:
        """Send the steady packets of these cycles, at most until `last_quiet_cycle`; see `DeferredBatch`."""


class InterfaceReceiver(ABC):
    """Receiver of the bytes that one client sends."""

    @abstractmethod
    def feed(self, data: bytes) -> None:
        """Process received bytes, in chunks of any size."""

    def end(self) -> None:
        """Process the end of the connection."""
        return None


class Interface(ABC):
    """One interface of the controller.

    By default, every firmware has the interface, and the interface only replies to clients. Subclasses can override
    this.
    """

    def is_offered(self) -> bool:
        """Whether the current firmware has this interface. If not, connections are refused."""
        return True

    def greeting(self) -> list[bytes]:
        """Return the packets that are sent at the beginning of a connection."""
        return []

    def next_cycle(self, cycle: int) -> int | None:
        """Return the first cycle after this one in which packets are due; None if no packet is planned."""
        return None

    def packets(self, cycle: int) -> Sequence[bytes | Deferred]:
        """Return the packets that have become due since the last call, and that all clients must receive.

        The server calls this in each cycle while a client is connected, except in cycles that are far too late. If
        clients need different packets, the interface sends them itself and returns none.
        """
        return []

    def steady_packet(self) -> Deferred | None:
        """Return the packet of this cycle if it is steady after the previous one; see `DeferredBatch`."""
        return None

    def later_packets(self, samples: Samples) -> Sequence[Deferred]:
        """Return the steady packets of cycles in which only the time and the targets change.

        Args:
            samples: Sensors of each cycle; see `ControlLoop.advance_many`.
        """
        raise NotImplementedError

    def last_ahead(self, cycle: int, last: int, clients: Sequence[BatchClient]) -> int:
        """Return the last cycle until which no packet of this interface has to be sent on time.

        Args:
            cycle: Current cycle.
            last: Upper limit of the result.
            clients: Clients of this interface.
        """
        wanted = self.next_cycle(cycle)
        return last if wanted is None else min(last, wanted - 1)

    def last_steady(self, cycle: int, last: int, clients: Sequence[BatchClient]) -> int:
        """Return the same as `last_ahead`, for cycles in which only the time and the targets change."""
        return self.last_ahead(cycle, last, clients)

    def send_ahead(self, cycle: int, samples: Samples | None, clients: Sequence[BatchClient]) -> None:
        """Send all packets until this cycle before they are due.

        Args:
            cycle: Last cycle, which `last_ahead` or `last_steady` has permitted.
            samples: Sensors of the last cycles, if only the time and the targets have changed in them; else None.
            clients: Clients of this interface.
        """
        return None

    def skip(self) -> None:
        """Discard the packets of this cycle, because no client is connected."""
        return None

    @abstractmethod
    def receiver(self, client: InterfaceClient) -> InterfaceReceiver:
        """Make the receiver for a new client."""


class ReadOnlyReceiver(InterfaceReceiver):
    """Receiver of the read-only ports, which counts received bytes and ignores them."""

    def __init__(self, counters: Counters) -> None:
        self._counters = counters

    def feed(self, data: bytes) -> None:
        self._counters.refused_bytes += len(data)


class LineReceiver(InterfaceReceiver):
    """Receiver that splits bytes into lines.

    Args:
        client: Client that sends the bytes. After its connection was closed, its bytes are ignored.
        counters: Counters to which the bytes of lines that are too long are added.
        on_line: Function that is called with each line, without its line ending.
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
                self._take(text)
            if not self._client.is_open:
                return
        self._extend(rest)

    def _take(self, line: str) -> None:
        self._on_line(line)

    def _extend(self, part: bytes) -> None:
        if self._is_too_long or len(self._line) + len(part) > LONGEST_LINE:
            self._counters.refused_bytes += len(self._line) + len(part)
            self._line.clear()
            self._is_too_long = True
        else:
            self._line += part


class ScriptReceiver(LineReceiver):
    """Receiver that assembles programs from the lines of a primary, secondary or real-time client.

    Args:
        client: Client that sends the lines.
        counters: Counters to which discarded bytes are added.
        on_line: Function that is called with each line.
        on_program: Function that is called with the text of each complete program. It returns False if it has discarded
            the program.
    """

    def __init__(
        self,
        client: InterfaceClient,
        counters: Counters,
        on_line: Callable[[str], object],
        on_program: Callable[[str], bool],
    ) -> None:
        super().__init__(client, counters, on_line)
        self._assembler = LineAssembler()
        self._on_program = on_program

    def _take(self, line: str) -> None:
        super()._take(line)
        refused = self._assembler.refused
        program = self._assembler.feed(line)
        self._counters.refused_bytes += self._assembler.refused - refused
        if program is not None and not self._on_program(program):
            self._counters.refused_bytes += len(program)

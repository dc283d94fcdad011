"""Data whose bytes are made when they are read. Only a simulated peer sends such data, over a simulated network.

A simulated controller sends 500 packets per second, and most programs read a few fields of them. So the controller
sends an object that remembers its state. The object takes the same route as bytes:

    interface -> server -> simulated connection -> transport -> receiver -> state -> callback

Each step that needs the bytes calls `bytes(packet)`. A state that is read from such a packet asks it only for the
fields that the callback reads (`linkcore.wire.deferred_packet`). A real socket accepts only bytes, so with real sockets
the bytes are made at once.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Generic, TypeVar

#: Longest time that the packets of a `DeferredBatch` cover, in s.
LONGEST_BATCH = 0.128


class Deferred:
    """Data whose bytes are made when they are read.

    It is not a buffer. So code that expects bytes raises an error instead of reading wrong ones.

    Args:
        head: First bytes of the data.
        is_steady: Whether the packet differs from the previous one only in its time, and in measured or computed
            values. Modes and signals are equal.

    Attributes:
        head, is_steady: See the arguments.
    """

    __slots__ = ("head", "is_steady")

    def __init__(self, head: bytes, is_steady: bool = False) -> None:
        self.head = head
        self.is_steady = is_steady

    # This is not an abstract base class, because `isinstance` takes several times as long for one.
    def __len__(self) -> int:
        """Return the number of bytes."""
        raise NotImplementedError

    def __bytes__(self) -> bytes:
        """Return the bytes."""
        raise NotImplementedError


class SteadyBytes(bytes):
    """Bytes of one whole packet that differs from the previous packet of its connection only in its time."""

    __slots__ = ()

    is_steady = True

    @property
    def head(self) -> bytes:
        """All bytes; see `Deferred.head`."""
        return self


D = TypeVar("D", bound="Deferred | SteadyBytes")


class DeferredBatch(Deferred, Generic[D]):
    """Packets that a simulated peer has sent one after another, and that the client reads at once.

    The packets are steady. They have one layout, and their times are equidistant.

    Args:
        packets: Packets in the order of sending, at least one. The sequence might make a packet when it is accessed.
        ages: Time from the arrival of each packet to the arrival of the last one, in s.

    Attributes:
        packets, ages: See the arguments.
        first, last: First and last packet.
    """

    __slots__ = ("_size", "ages", "first", "last", "packets")

    def __init__(self, packets: Sequence[D], ages: Sequence[float]) -> None:
        self.first, self.last = packets[0], packets[-1]
        super().__init__(self.first.head + self.last.head, is_steady=True)
        self.packets = packets
        self.ages = ages
        self._size = len(packets) * len(self.first)

    def __len__(self) -> int:
        return self._size

    def __bytes__(self) -> bytes:
        return b"".join(map(bytes, self.packets))


class Unread:
    """Packet with parts that a simulated peer has sent. It is only made if somebody asks for it."""

    def read(self) -> Any:
        """Return the packet."""
        raise NotImplementedError

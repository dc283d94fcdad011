"""What a stream asks of a packet protocol: frames out of bytes, typed packets out of frames, and their counters."""

from __future__ import annotations

from typing import Any, Protocol

from ..stamp import Stamp
from .cycles import MissedCycles
from .framing import Framer

__all__ = ["PacketProtocol"]


class PacketProtocol(Protocol):
    """The protocol of one connection, sans-IO; a stream makes a new one each time it connects."""

    framer: Framer
    #: counts the cycles that are missing; None as long as the packets have no time of the peer's clock
    cycles: MissedCycles | None

    @property
    def unknown(self) -> int:
        """Packets, or parts of one, of a type that no layout is known for."""

    @property
    def tails(self) -> int:
        """Packets, or parts of one, that end in bytes which no known layout explains."""

    def decode(self, frame: bytes, stamp: Stamp | None = None) -> Any:
        """The typed packet in one frame.

        Raises:
            PacketError: no layout holds it. It is not counted in `unknown` or `tails`.
        """

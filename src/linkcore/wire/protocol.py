"""What a stream asks of a protocol."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

from ..stamp import Stamp
from .framing import Framer

__all__ = ["Session"]


class Session(Protocol):
    """One connection's protocol, sans-IO; a stream makes a new one each time it connects."""

    framer: Framer

    @property
    def unknown(self) -> int:
        """Packets, or parts of one, of a type that no layout is known for."""

    @property
    def tails(self) -> int:
        """Packets, or parts of one, that end in bytes which no known layout explains."""

    def decode(self, frame: bytes, stamp: Stamp | None = None) -> Any:
        """The typed packet in one frame; raises `PacketError`."""

    def decode_all(self, frames: Sequence[bytes], stamp: Stamp | None = None) -> Sequence[Any]:
        """The typed packets in many frames; raises `PacketError` if one of them is bad."""

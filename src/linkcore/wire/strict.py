"""Strict decoding: bytes that no layout explains are errors, rather than kept and counted.

For tests against new firmware, not for the operation of a robot: with the environment variable
``URLINK_STRICT=1``, read when this module is imported.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import Any, Protocol

from ..errors import PacketError
from ..stamp import Stamp

__all__ = ["check_explained", "is_strict", "strictly"]

#: Whether it was asked for.
_STRICT = os.environ.get("URLINK_STRICT", "") not in ("", "0")


def is_strict() -> bool:
    """Whether bytes that no layout explains are errors."""
    return _STRICT


class Counting(Protocol):
    """Decodes, and counts what it does not know."""

    @property
    def unknown(self) -> int:
        """Packets, or parts of one, of a type that no layout is known for."""

    @property
    def tails(self) -> int:
        """Packets, or parts of one, that end in bytes which no known layout explains."""

    @property
    def decode(self) -> Callable[..., Any]:
        """The packet in one frame."""


def check_explained(packet: Any, unknown: int, tails: int) -> None:
    """Refuse a packet of which so many parts are not known.

    Raises:
        PacketError: there are any.
    """
    kind = type(packet).__name__
    if unknown:
        raise PacketError("it is, or holds, a type that is not known (URLINK_STRICT)", packet=kind)
    if tails:
        raise PacketError("it, or a part of it, ends in bytes that are not known (URLINK_STRICT)", packet=kind)


def strictly(decoder: Counting) -> Callable[..., Any]:
    """What `decoder.decode` does, for packets of which every byte is known.

    Raises, when it is called:
        PacketError: no layout holds the packet, or a part of it is of an unknown type, or ends in unknown bytes.
    """

    def decode(frame: bytes, stamp: Stamp | None = None) -> Any:
        unknown, tails = decoder.unknown, decoder.tails
        packet = decoder.decode(frame, stamp)
        check_explained(packet, decoder.unknown - unknown, decoder.tails - tails)
        return packet

    return decode

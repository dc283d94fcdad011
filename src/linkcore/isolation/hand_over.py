"""What the process that reads a connection tells the one that it reads for."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from typing import NamedTuple

from ..stamp import Stamp

__all__ = ["CONNECTED", "DATA", "LOST", "Record", "Records"]

CONNECTED = b"C"  # the connection was made
DATA = b"D"  # bytes, as they came
LOST = b"L"  # it could not be made, or was lost: the class of the error and its text, with a space between

_HEADER = struct.Struct("<cIdd")


class Record(NamedTuple):
    """One of them."""

    kind: bytes
    payload: bytes
    stamp: Stamp

    def __bytes__(self) -> bytes:
        return _HEADER.pack(self.kind, len(self.payload), *self.stamp) + self.payload


class Records:
    """Cuts them out of a stream of bytes."""

    def __init__(self) -> None:
        self._rest = bytearray()

    def feed(self, data: bytes) -> Iterator[Record]:
        """The records that are whole now."""
        self._rest += data
        while len(self._rest) >= _HEADER.size:
            kind, length, monotonic, wall = _HEADER.unpack_from(self._rest)
            end = _HEADER.size + length
            if len(self._rest) < end:
                return
            payload = bytes(self._rest[_HEADER.size : end])
            del self._rest[:end]
            yield Record(kind, payload, Stamp(monotonic, wall))

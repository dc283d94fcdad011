"""What the process that reads a connection hands over: records through a pipe, the newest packet in shared memory.

There is no lock between processes. A checksum says whether a packet in memory is whole; a reader that came between two
writes looks again. So it holds also on processors that reorder writes.
"""

from __future__ import annotations

import mmap
import os
import struct
import tempfile
import zlib
from collections.abc import Iterator
from typing import NamedTuple

from ..clock import Stamp

__all__ = ["CONNECTED", "DATA", "LOST", "HandedOver", "Records", "Slot"]

CONNECTED = b"C"  # the connection was made, with the s of its handshake
DATA = b"D"  # bytes, as they came
LOST = b"L"  # it could not be made, or was lost: the class of the error and its text, with a space between

_HEADER = struct.Struct("<cIdd")


class HandedOver(NamedTuple):
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

    def feed(self, data: bytes) -> Iterator[HandedOver]:
        """The records that are whole now."""
        self._rest += data
        while len(self._rest) >= _HEADER.size:
            kind, length, monotonic, wall = _HEADER.unpack_from(self._rest)
            end = _HEADER.size + length
            if len(self._rest) < end:
                return
            payload = bytes(self._rest[_HEADER.size : end])
            del self._rest[:end]
            yield HandedOver(kind, payload, Stamp(monotonic, wall))


#: Number of the packet, its length, checksum of all but itself, monotonic and wall time.
_SLOT = struct.Struct("<QIIdd")
#: Bytes for one packet; longer ones are not kept.
_ROOM = 1 << 16
#: How often a reader looks again. Writing takes a microsecond or two, and one packet follows another after 2 ms.
_LOOKS = 20


class Slot:
    """Room for one packet.

    Args:
        descriptor: of the file that is shared; None makes one without a name, which is gone with the last process that
            has it.

    Attributes:
        descriptor: the same.
    """

    def __init__(self, descriptor: int | None = None) -> None:
        if descriptor is None:
            with tempfile.TemporaryFile() as file:
                file.truncate(_SLOT.size + _ROOM)
                descriptor = os.dup(file.fileno())
        self.descriptor = descriptor
        self._memory = mmap.mmap(descriptor, _SLOT.size + _ROOM)
        self._number = 0

    def put(self, packet: bytes, stamp: Stamp) -> None:
        """Replace the packet."""
        if len(packet) <= _ROOM:
            self._number += 1
            self._memory[: _SLOT.size + len(packet)] = _packed(self._number, packet, stamp)

    def clear(self) -> None:
        """There is none any more."""
        self._memory[: _SLOT.size] = bytes(_SLOT.size)

    def get(self) -> tuple[int, bytes, Stamp] | None:
        """The number of the packet, the packet, and when its bytes came; None if there is none."""
        for _ in range(_LOOKS):
            number, length, checksum, monotonic, wall = _SLOT.unpack_from(self._memory)
            if not number:
                return None
            if length <= _ROOM:
                packet = self._memory[_SLOT.size : _SLOT.size + length]
                if _checksum(number, packet, monotonic, wall) == checksum:
                    return number, packet, Stamp(monotonic, wall)
        return None

    def close(self) -> None:
        """Give it back. Idempotent."""
        if not self._memory.closed:
            self._memory.close()
            os.close(self.descriptor)


def _packed(number: int, packet: bytes, stamp: Stamp) -> bytes:
    checksum = _checksum(number, packet, *stamp)
    return _SLOT.pack(number, len(packet), checksum, *stamp) + packet


def _checksum(number: int, packet: bytes, monotonic: float, wall: float) -> int:
    return zlib.crc32(packet, zlib.crc32(_SLOT.pack(number, len(packet), 0, monotonic, wall)))

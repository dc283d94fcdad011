"""Frame boundaries of RTDE, for the client's and for the controller's side.

A package begins with its size in two bytes and its type in one (docs/protocols/rtde.md, section Packages). In step, the
size is believed where the type can have it. Out of step, a package is believed if another one stands where it ends.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from types import MappingProxyType

from ..headers import interface_of

#: Bytes of names in one request (vendor's guide).
LONGEST_NAMES = 2048

# Larger packages are not believed. All 406 variables have 2.9 kB, and their names some 10 kB, in several requests;
# 1024 unknown names of one letter would be answered by 10 kB of NOT_FOUND.
_LARGEST = 1 << 14

#: Type byte -> possible sizes of a client's packages, header included.
REQUEST_SIZES: Mapping[int, range] = MappingProxyType(
    {
        ord("V"): range(5, 6),
        ord("v"): range(3, 4),
        ord("O"): range(3, _LARGEST),
        ord("I"): range(3, _LARGEST),
        ord("S"): range(3, 4),
        ord("P"): range(3, 4),
        ord("M"): range(6, 517),
        ord("U"): range(4, _LARGEST),
    }
)

#: Type byte -> possible sizes of a controller's packages, header included.
REPLY_SIZES: Mapping[int, range] = MappingProxyType(
    {
        ord("V"): range(4, 5),
        ord("v"): range(19, 20),
        ord("O"): range(3, _LARGEST),
        ord("I"): range(4, _LARGEST),
        ord("S"): range(4, 5),
        ord("P"): range(4, 5),
        ord("M"): range(4, _LARGEST),  # protocol 1: text to the end
        ord("U"): range(3, _LARGEST),
    }
)

_HEAD = struct.Struct(">HB")

# Bytes by which another interface is recognised.
_PEER = 5


class RtdeBoundary:
    """Frame boundaries of one side of an RTDE connection.

    Args:
        sizes: type byte -> sizes that a package of it can have: `REPLY_SIZES` for what a controller sends,
            `REQUEST_SIZES` for what a client sends.

    Packages of unknown types are taken once a known one has come, where another package follows them.
    """

    largest = _LARGEST + _HEAD.size
    pace = 64
    size, head = 0, b""
    last: bytes | bytearray = b""

    def __init__(self, sizes: Mapping[int, range]) -> None:
        self._sizes = sizes
        self._is_begun = False

    def __str__(self) -> str:
        return "RTDE (port 30004)"

    def whole(self, buffer: bytes | bytearray) -> list[bytes]:
        """One package that fills the buffer: the common case."""
        there = len(buffer)
        if there < _HEAD.size:
            return []
        size, kind = _HEAD.unpack_from(buffer)
        if size != there or size not in self._sizes.get(kind, ()):
            return []
        self._is_begun = True
        return [bytes(buffer)]

    def check(self, buffer: bytes | bytearray, at: int) -> tuple[int, int]:
        """See `FrameBoundary.check`."""
        there = len(buffer) - at
        if there < _HEAD.size:
            return 0, _HEAD.size
        size, kind = _HEAD.unpack_from(buffer, at)
        sizes = self._sizes.get(kind)
        if sizes is not None and size in sizes:
            self._is_begun = True
            return size, size
        if sizes is None and self._is_begun and _HEAD.size <= size < _LARGEST:
            return self._followed(buffer, at, size)
        # At the beginning the peer may be another service, which takes some bytes more to recognise.
        return 0, 0 if self._is_begun else _PEER

    def search(self, buffer: bytes | bytearray, start: int) -> tuple[int, int, int]:
        """See `FrameBoundary.search`."""
        sizes = self._sizes
        last = len(buffer) - _HEAD.size
        for at in range(start, last + 1):
            kind = buffer[at + 2]
            if kind not in sizes:
                continue
            size = (buffer[at] << 8) | buffer[at + 1]
            if size not in sizes[kind]:
                continue
            found, need = self._followed(buffer, at, size)
            if found or need > len(buffer) - at:
                return at, found, need
        return max(start, last + 1), 0, _HEAD.size

    def peer(self, buffer: bytes | bytearray) -> str | None:
        """See `FrameBoundary.peer`."""
        return interface_of(buffer) if len(buffer) >= _PEER else None

    def _followed(self, buffer: bytes | bytearray, at: int, size: int) -> tuple[int, int]:
        """As `check`: a package is believed if one of a known type and of its size stands where it ends."""
        need = size + _HEAD.size
        if len(buffer) - at < need:
            return size, need
        next_size, next_kind = _HEAD.unpack_from(buffer, at + size)
        if next_size not in self._sizes.get(next_kind, ()):
            return 0, 0
        self._is_begun = True
        return size, need

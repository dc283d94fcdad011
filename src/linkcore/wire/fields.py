"""The parts of which a packet is declared: the header before it, and its fields."""

from __future__ import annotations

import struct
from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple

from .shapes import Number, Shape
from .version import Since, Version

__all__ = ["Field", "Header"]


class Header:
    """Numbers that precede the fields of a packet; `size`, the bytes of the whole packet, is one of them.

    ``Header(size=Int32sb, type=Int8ub)``

    Attributes:
        parts: name -> number, in wire order.
        width: bytes of the header.
    """

    def __init__(self, **parts: Number) -> None:
        self.parts: Mapping[str, Number] = MappingProxyType(parts)
        self._struct = struct.Struct(">" + "".join(number.code for number in parts.values()))
        self.width = self._struct.size

    def pack(self, **values: int) -> bytes:
        """The header on the wire; a part that is not given is zero, and what is no part of it is passed over."""
        return self._struct.pack(*(values.get(name, 0) for name in self.parts))

    def unpack(self, data: bytes) -> dict[str, int]:
        """name -> value of the parts of the header that `data` begins with."""
        return dict(zip(self.parts, self._struct.unpack_from(data), strict=True))


class Field(NamedTuple):
    """The declaration of one field; `linkcore.wire.packet.wire` describes each entry."""

    name: str
    shape: Shape
    unit: str = ""
    doc: str = ""
    since: Since = Since("0.0")
    until: Version | None = None
    before: tuple[Version, Shape] | None = None
    interleave: str | None = None
    block: str | None = None

    def shape_in(self, version: Version) -> Shape | None:
        """The shape that `version` sends, or None where it does not send the field."""
        if version not in self.since or (self.until is not None and version >= self.until):
            return None
        if self.before is not None and version < self.before[0]:
            return self.before[1]
        return self.shape

    @property
    def steps(self) -> set[Version]:
        """The versions at which the answer of `shape_in` can change."""
        others = [self.until, None if self.before is None else self.before[0]]
        return self.since.steps | {version for version in others if version is not None}

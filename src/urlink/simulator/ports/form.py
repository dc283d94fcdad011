"""A packet laid out once and filled in many times: a controller packs hundreds of them a second.

The layouts are those of the schemas in `urlink.interfaces`.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from itertools import groupby
from typing import Any

from linkcore.wire.layout import Layout
from urlink.interfaces.headers import PACKAGE

__all__ = ["Fields", "Form", "package"]

#: Names of fields -> plain numbers, or lists of them.
Fields = Mapping[str, Any]


class Form:
    """A packet of one layout and of fixed size, filled in and packed many times.

    Gives the bytes of `Layout.encode` in a tenth of the time: values stay where they were put, and one `struct` packs
    them. Values are plain numbers and lists of them, checked only by `struct`.
    """

    def __init__(self, layout: Layout) -> None:
        codes: list[str] = [""] * sum(place.count or 1 for place in layout.places.values())
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
        self.size = layout.size

    def pack(self, fields: Fields) -> bytes:
        """The packet with these fields, others unchanged; fields that are not in the layout are skipped."""
        values, places = self._values, self._at
        for name, value in fields.items():
            at = places.get(name)
            if at is not None:
                values[at] = value
        return self._struct.pack(self._header, *values)


def package(kind: int, body: bytes) -> bytes:
    """A package or sub-package of the primary and secondary interface."""
    return PACKAGE.pack(size=PACKAGE.width + len(body), type=kind) + body

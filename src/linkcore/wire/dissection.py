"""Every byte of a packet with its meaning, as construct reads it with the schema of its layout."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

from .fields import Field, Header
from .layout import Layout

__all__ = ["Row", "dissect", "header_rows"]


class Row(NamedTuple):
    """One line of a dissection: a stretch of bytes and what it means."""

    offset: int
    data: bytes
    name: str
    value: Any
    unit: str
    doc: str


def header_rows(header: Header, data: bytes) -> Iterator[Row]:
    """The parts of the header that `data` begins with."""
    offset = 0
    for name, value in header.unpack(data).items():
        end = offset + header.parts[name].width
        yield Row(offset, data[offset:end], name, value, "B" if name == "size" else "", "header")
        offset = end


def dissect(layout: Layout, data: bytes) -> Iterator[Row]:
    """Every stretch of `data` with its meaning, in wire order, the unknown tail last.

    Args:
        layout: that of the packet.
        data: the whole packet, which has been decoded with this layout.
    """
    from .schema import as_struct  # which imports construct: a program that dissects nothing does not pay for that

    parsed = as_struct(layout, located=True).parse(data)
    yield from header_rows(layout.header, data)
    for run in layout.runs:
        first = run[0].field
        if first.interleave is None:
            yield _row(first, first.name, parsed[first.name])
            continue
        for number, element in enumerate(parsed[first.interleave]):
            for place in run:
                name = place.field.name
                yield _row(place.field, f"{name}[{number}]", element[name])
    if parsed.tail.data:
        yield Row(parsed.tail.offset1, parsed.tail.data, "tail", None, "", "bytes that no known layout explains")


def _row(field: Field, name: str, found: Any) -> Row:
    return Row(found.offset1, found.data, name, found.value, field.unit, field.doc)

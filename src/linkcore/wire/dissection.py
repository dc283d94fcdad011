"""Every byte of a packet with its meaning."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

from .fields import Header
from .layout import Layout, Place

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


def dissect(layout: Layout, data: bytes, values: Mapping[str, Any]) -> Iterator[Row]:
    """Every stretch of `data` with its meaning, in wire order, the unknown tail last.

    Args:
        layout: that of the packet.
        data: the whole packet.
        values: name -> value of each field, as the user holds it.
    """
    yield from header_rows(layout.header, data)
    if layout.has_text:
        for place, start, end, _ in layout.stretches(data):
            yield _row(place, start, data[start:end], values[place.field.name])
    else:
        for run in layout.runs:
            yield from _run_rows(run, data, values)
    end = layout.end(data)
    if end < len(data):
        yield Row(end, data[end:], "tail", None, "", "bytes that no known layout explains")


def _run_rows(run: list[Place], data: bytes, values: Mapping[str, Any]) -> Iterator[Row]:
    if run[0].field.interleave is None:
        (place,) = run
        yield _row(place, place.offset, data[place.offset : place.offset + place.size], values[place.field.name])
        return
    for number in range(run[0].count or 0):
        for place in run:
            start = place.offset + number * place.stride
            row = _row(place, start, data[start : start + place.width], values[place.field.name][number])
            yield row._replace(name=f"{row.name}[{number}]")


def _row(place: Place, offset: int, data: bytes, value: Any) -> Row:
    return Row(offset, data, place.field.name, value, place.field.unit, place.field.doc)

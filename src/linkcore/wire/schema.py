"""Construct schemas of packet layouts. They parse and build packets, check their sizes, and dissect them.

The schemas are made from the same declarations as the fast decoders, but only construct reads them. So a property test
can check on random bytes that both are equal, for every layout. `dissect` gets the meaning of each byte from a schema.
Only this module imports construct, because importing it takes longer than importing all other modules.

`compile()` of construct is not used, because it omits the checks of sizes. `Optional` and `Select` are not used,
because they interpret a broken field as the end of the data.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import cache
from typing import Any, NamedTuple

import construct

from .fields import Array, Field, Header, Number, Raw, Shape
from .layout import Layout
from .schema_text import PacketStruct, SizedPacket


def as_construct(shape: Shape) -> Any:
    """Return the construct of one shape.

    Its values are the values that users get; arrays are lists.
    """
    if isinstance(shape, Number):
        return getattr(construct, shape.name)
    if isinstance(shape, Array):
        return construct.Array(shape.count, as_construct(shape.element))
    raw: Any
    if isinstance(shape, Raw):
        rest = construct.GreedyBytes
        raw = rest if shape.prefix is None else construct.Prefixed(as_construct(shape.prefix), rest)
        if shape.least:
            least = shape.least
            raw = construct.ExprValidator(raw, lambda obj, context: len(obj) >= least)
    else:
        assert shape.number is not None
        raw = as_construct(shape.number)
    read, write = shape.read, shape.write
    if read is None:
        return raw
    return construct.ExprAdapter(raw, lambda obj, context: read(obj), lambda obj, context: write(obj))


def fields_of(layout: Layout, wrap: Callable[[Field, Any], Any]) -> Iterator[Any]:
    """Yield the fields of a layout in wire order.

    Interleaved fields are an array of structs, as on the wire.

    Args:
        layout: Layout.
        wrap: Function that gets each field and its construct, and returns the construct to use.
    """
    for run in layout.runs:
        first = run[0].field
        if first.interleave is None:
            yield _named(first, wrap(first, as_construct(run[0].shape)))
        else:
            elements = (_named(each.field, wrap(each.field, as_construct(_element(each.shape)))) for each in run)
            yield first.interleave / construct.Array(run[0].count, construct.Struct(*elements))


def _named(field: Field, shape: Any) -> Any:
    return construct.Renamed(shape, newname=field.name, newdocs=field.unit)


def checked_fields(layout: Layout) -> Iterator[Any]:
    """Yield the fields of a layout.

    Fields that identify the packet are constants, and blocks are optional.
    """

    def checked(field: Field, shape: Any) -> Any:
        if field.name in layout.constants:
            return construct.Const(layout.constants[field.name], shape)
        return shape if field.block is None else construct.If(lambda context: context[field.block], shape)

    return fields_of(layout, checked)


def packet_schema(layout: Layout) -> Any:
    """Return a layout as the schema of one complete packet; `urlink.schema` describes its checks."""
    known = dict(layout.constants)
    names = list(layout.header.parts)
    is_fixed = not layout.has_text and not layout.has_block
    if is_fixed:
        known["size"] = layout.size
    else:
        names.remove("size")
    head = [
        name / (construct.Const(known[name], number) if name in known else number)
        for name, number in ((name, as_construct(layout.header.parts[name])) for name in names)
    ]
    fields = checked_fields(layout)
    if is_fixed:
        return PacketStruct(layout.name, *head, *fields)
    return sized(layout.name, layout.header, construct.Struct(*head, *fields, construct.Terminated))


def sized(title: str, header: Header, body: Any) -> Any:
    """Return the schema of a size, which includes itself, followed by a `body` that fills exactly this size."""
    return SizedPacket(title, as_construct(header.parts["size"]), body)


@cache
def as_struct(layout: Layout, *, located: bool = False) -> Any:
    """Return a layout as one `Struct` for any bytes: the parts of the header, the fields, and the rest as `tail`.

    Only the fields have to fit, so that packets that are damaged, or newer than the layout, can be examined.

    Args:
        layout: Layout.
        located: Whether each field is construct's `RawCopy`, with its bytes and offsets.
    """
    header = construct.Struct(*(name / as_construct(number) for name, number in layout.header.parts.items()))
    keep: Callable[[Any], Any] = construct.RawCopy if located else lambda shape: shape
    fields = fields_of(layout, lambda field, shape: keep(shape))
    return construct.Struct("header" / header, *fields, "tail" / keep(construct.GreedyBytes))


def _element(shape: Shape) -> Shape:
    assert isinstance(shape, Array), "an interleaved field is an array"
    return shape.element


class Row(NamedTuple):
    """Line of a dissection: a section of bytes and the meaning of these bytes."""

    offset: int
    data: bytes
    name: str
    value: Any
    unit: str
    doc: str


def header_rows(header: Header, data: bytes) -> Iterator[Row]:
    """Yield the parts of the header at the beginning of `data`."""
    offset = 0
    for name, value in header.unpack(data).items():
        end = offset + header.parts[name].width
        yield Row(offset, data[offset:end], name, value, "B" if name == "size" else "", "header")
        offset = end


def dissect(layout: Layout, data: bytes) -> Iterator[Row]:
    """Yield each section of `data` with its meaning, in wire order.

    The unknown tail is the last.

    Args:
        layout: Layout of the packet.
        data: Complete packet, which was decoded with this layout.
    """
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

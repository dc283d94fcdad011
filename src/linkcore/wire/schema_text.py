"""Construct schemas as text, with the offset, type and unit of each field.

`linkcore.wire.schema` imports this module.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import construct

#: construct -> its name, such as "Float64b". If it has several names, the name with the size is used.
_NAMES: dict[int, str] = {
    id(value): name
    for name, value in sorted(vars(construct).items())
    if isinstance(value, construct.Construct) and name.startswith(("Int", "Float", "Greedy"))
}


class _Line(NamedTuple):
    offset: int | None
    name: str
    type: str
    unit: str = ""


class _Printed:
    """A construct whose text is a table of its fields.

    Attributes:
        title: Name of the packet.
    """

    title: str

    def __repr__(self) -> str:
        return schema_text(self.title, self)


class PacketStruct(_Printed, construct.Struct):  # type: ignore[misc]  # construct has no types
    """A `construct.Struct` that prints its fields."""

    def __init__(self, title: str, *fields: Any) -> None:
        super().__init__(*fields)
        self.title = title


class SizedPacket(_Printed, construct.Prefixed):  # type: ignore[misc]  # construct has no types
    """A size, which includes itself, followed by a body that fills exactly this size."""

    def __init__(self, title: str, size: Any, body: Any) -> None:
        super().__init__(size, body, includelength=True)
        self.title = title


def schema_text(title: str, schema: Any) -> str:
    """Return a line with the name and the size of a packet, and one line for each field."""
    size = _size(schema)
    lines = [_Line(None, "field", "type", "unit"), *_lines(schema, 0, "")]
    name_width, type_width = max(len(line.name) for line in lines), max(len(line.type) for line in lines)
    rows = []
    for number, line in enumerate(lines):
        offset = "" if line.offset is None else str(line.offset)
        first = offset if number else "offset"
        rows.append(f"{first:>6}  {line.name:{name_width}}  {line.type:{type_width}}  {line.unit}".rstrip())
    return "\n".join([f"{title}, {'size varies' if size is None else f'{size} bytes'}", *rows])


def _size(schema: Any) -> int | None:
    try:
        return int(schema.sizeof())
    except (construct.SizeofError, KeyError, AttributeError):  # the size depends on another field
        return None


def _lines(schema: Any, offset: int | None, indent: str) -> Iterator[_Line]:
    """Yield the fields of a schema. An offset is None if it varies, and inside repeated parts."""
    if isinstance(schema, construct.Renamed):
        yield _Line(offset, f"{indent}{schema.name}", _type(schema.subcon), schema.docs or "")
        yield from _lines(_repeated(schema.subcon), None, f"{indent}  ")
    elif isinstance(schema, construct.Struct):
        for field in schema.subcons:
            if field.name is not None:
                yield from _lines(field, offset, indent)
            size = _size(field)
            offset = None if offset is None or size is None else offset + size
    elif isinstance(schema, construct.Switch):
        for key, case in schema.cases.items():
            yield _Line(None, f"{indent}{key}: {getattr(case, 'title', '')}", "")
            yield from _lines(case, None, f"{indent}  ")
    elif isinstance(schema, construct.Prefixed):
        if schema.includelength:
            yield _Line(offset, f"{indent}size", _type(schema.lengthfield), "B")
        size = _size(schema.lengthfield)
        yield from _lines(schema.subcon, None if offset is None or size is None else offset + size, indent)
    elif isinstance(schema, (construct.Adapter, construct.IfThenElse)):
        yield from _lines(_repeated(schema), offset, indent)


def _repeated(schema: Any) -> Any:
    """Return the element of an array, an adapter or a condition; or else the schema itself."""
    if isinstance(schema, construct.FocusedSeq):  # a count, followed by this number of elements
        return _repeated(schema.subcons[-1].subcon)
    if isinstance(schema, construct.IfThenElse):
        return _repeated(schema.thensubcon)
    if isinstance(schema, (construct.Array, construct.GreedyRange, construct.Adapter)):
        return _repeated(schema.subcon)
    return schema


def _type(schema: Any) -> str:
    """Return the type of a field, in the short form of packet declarations."""
    if id(schema) in _NAMES:
        return _NAMES[id(schema)]
    if isinstance(schema, construct.Const):
        return f"{_type(schema.subcon)} = {schema.value!r}"
    if isinstance(schema, construct.Array):
        return f"{_type(schema.subcon)}[{'...' if callable(schema.count) else schema.count}]"
    if isinstance(schema, construct.GreedyRange):
        return f"{_type(schema.subcon)}[...]"
    if isinstance(schema, construct.FocusedSeq):
        return f"{_type(_repeated(schema))}[...], after their count"
    if isinstance(schema, construct.IfThenElse):
        return f"{_type(schema.thensubcon)}, if sent"
    if isinstance(schema, construct.Prefixed):
        content = _type(schema.subcon)
        return content if schema.includelength else f"{content}, after its size in {_type(schema.lengthfield)}"
    if isinstance(schema, construct.Bytes):
        return f"Bytes[{schema.length}]"
    if isinstance(schema, (construct.Renamed, construct.Adapter)):
        return _type(schema.subcon)
    return str(type(schema).__name__)

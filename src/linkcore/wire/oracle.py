"""construct's reading of a layout: slow, and independent of this project.

The decoders that run are derived from the same declarations. A property test holds them equal to this one, on random
bytes, for every layout. Only here is construct imported, since importing it takes longer than all else.

Its `compile()` is not used: it drops bounds checks. Nor are `GreedyRange`, `Optional` and `Select`: they take a broken
field for the end of the data.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import construct

from .layout import Layout
from .shapes import Array, Number, Raw, Shape

__all__ = ["as_construct", "as_struct", "parse"]


def as_construct(shape: Shape) -> Any:
    """The construct of one shape, whose values are what the user holds."""
    if isinstance(shape, Number):
        return getattr(construct, shape.name)
    if isinstance(shape, Array):
        return construct.Array(shape.count, as_construct(shape.element))
    raw: Any
    if isinstance(shape, Raw):
        rest = construct.GreedyBytes
        raw = rest if shape.prefix is None else construct.Prefixed(as_construct(shape.prefix), rest)
    else:
        assert shape.number is not None
        raw = as_construct(shape.number)
    read, write = shape.read, shape.write
    if read is None:
        return raw
    return construct.ExprAdapter(raw, lambda obj, context: read(obj), lambda obj, context: write(obj))


@cache
def as_struct(layout: Layout) -> Any:
    """A layout as one construct `Struct`; its `tail` is what follows the last field."""
    header = construct.Struct(*(name / as_construct(number) for name, number in layout.header.parts.items()))
    parts = ["header" / header]
    for run in layout.runs:
        if run[0].field.interleave is None:
            parts.append(run[0].field.name / as_construct(run[0].shape))
        else:
            # An interleaved field is an array of its own shape; construct has an array of them all.
            elements = [(place.field.name, place.shape) for place in run]
            element = construct.Struct(*(name / as_construct(_element(shape)) for name, shape in elements))
            parts.append(run[0].field.interleave / construct.Array(run[0].count, element))
    return construct.Struct(*parts, "tail" / construct.GreedyBytes)


def _element(shape: Shape) -> Shape:
    assert isinstance(shape, Array), "what is interleaved is an array"
    return shape.element


def parse(layout: Layout, data: bytes) -> dict[str, Any]:
    """name -> value of `data`, through construct alone.

    Raises:
        construct.ConstructError: it does not hold the fields.
    """
    parsed = as_struct(layout).parse(data)
    values: dict[str, Any] = {}
    for run in layout.runs:
        key = run[0].field.interleave
        for place in run:
            name = place.field.name
            values[name] = parsed[name] if key is None else [row[name] for row in parsed[key]]
    return values

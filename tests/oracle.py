"""construct's reading of a layout, by which the fast decoders are judged."""

from __future__ import annotations

from typing import Any

from linkcore.wire.layout import Layout
from linkcore.wire.schema import as_struct

__all__ = ["parse"]


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

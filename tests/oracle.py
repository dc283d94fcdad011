"""Reference decoder based on construct; tests compare the fast decoders with it."""

from __future__ import annotations

from typing import Any

from linkcore.wire.layout import Layout
from linkcore.wire.schema import as_struct

__all__ = ["parse"]


def parse(layout: Layout, data: bytes) -> dict[str, Any]:
    """Decode `data` with construct only; return a dictionary of names and values.

    Raises:
        construct.ConstructError: If `data` does not contain all fields.
    """
    parsed = as_struct(layout).parse(data)
    values: dict[str, Any] = {}
    for run in layout.runs:
        key = run[0].field.interleave
        for place in run:
            name = place.field.name
            values[name] = parsed[name] if key is None else [row[name] for row in parsed[key]]
    return values

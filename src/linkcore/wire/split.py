"""A packet of mixed widths in two parts: vectors of doubles, swapped by numpy all at once, and every other number.

Unpacking makes an object of each number, and packing them again makes a vector of six. Where there are many vectors,
it is quicker to unpack only the rest, and to swap the stretch of bytes that holds them when one is asked for.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterable, Sequence
from operator import itemgetter
from typing import TYPE_CHECKING, Any

import numpy as np

from .layout import MANY_CELLS, NATIVE_DOUBLE, WIRE_DOUBLE

if TYPE_CHECKING:
    from .fields import Field, Shape
    from .layout import Place


def _is_vector(shape: Shape) -> bool:
    """A field of this shape is an array of doubles."""
    return shape.count is not None and shape.read is None and shape.number is not None and shape.number.code == "d"


def is_split(fields: Iterable[Field]) -> bool:
    """Whether a packet of these fields is best taken in two parts: it always has all, many of them vectors."""
    fields = list(fields)
    is_fixed = all(
        field.shape.number is not None
        and field.interleave is None
        and field.block is None
        and field.until is None
        and field.before is None
        and field.since.firsts == ((0, 0),)
        for field in fields
    )
    return is_fixed and sum(field.shape.count or 0 for field in fields if _is_vector(field.shape)) >= MANY_CELLS


def split_indices(fields: Iterable[tuple[str, Shape]]) -> dict[str, int | slice]:
    """name -> index, or slice, of each field among the numbers; of a vector its index among the vectors."""
    found: dict[str, int | slice] = {}
    numbers = vectors = 0
    for name, shape in fields:
        if _is_vector(shape):
            found[name] = vectors
            vectors += 1
        else:
            count = shape.count or 1
            found[name] = numbers if shape.count is None else slice(numbers, numbers + count)
            numbers += count
    return found


class Split:
    """What takes a packet in two parts.

    Args:
        places: of the fields, in wire order.
        size: bytes of the packet.

    Attributes:
        numbers: the struct of a whole packet that gives its numbers.
        vectors: ``vectors(data)``: the vectors of a packet that is long enough, a tuple of read-only float64 arrays.
    """

    def __init__(self, places: Iterable[Place], size: int) -> None:
        codes, end = [">"], 0
        #: offset within a cell of 8 bytes -> number and place of each vector that lies so
        aligned: dict[int, list[tuple[int, Place]]] = {}
        for place in places:
            if _is_vector(place.shape):
                aligned.setdefault(place.offset % 8, []).append((sum(map(len, aligned.values())), place))
                continue
            assert place.number is not None, "there is no text"
            codes.append(f"{place.offset - end}x{place.count or 1}{place.number.code}")
            end = place.offset + place.size
        self.numbers = struct.Struct("".join([*codes, f"{size - end}x"]))
        parts = [_swapper([place for _, place in members]) for members in aligned.values()]
        numbers = [number for members in aligned.values() for number, _ in members]
        self.vectors = parts[0] if len(parts) == 1 else _joined(parts, numbers)


def _swapper(places: Sequence[Place]) -> Callable[[bytes], tuple[Any, ...]]:
    """What makes the vectors of one alignment: one stretch of bytes, swapped as a whole, and a view for each."""
    start = places[0].offset
    count = (places[-1].offset + places[-1].size - start) // 8
    begins = [(place.offset - start) // 8 for place in places]
    slices = [slice(begin, begin + (place.count or 1)) for begin, place in zip(begins, places, strict=True)]
    views = _picker(slices)
    frombuffer = np.frombuffer

    def vectors(data: bytes) -> tuple[Any, ...]:
        cells = frombuffer(data, WIRE_DOUBLE, count, start).astype(NATIVE_DOUBLE)
        cells.setflags(False)  # type: ignore[call-arg]  # write; by keyword it takes longer
        return views(cells)

    return vectors


def _joined(parts: Sequence[Callable[[bytes], tuple[Any, ...]]], numbers: Sequence[int]) -> Callable[[bytes], Any]:
    """The vectors of all parts by their numbers, which are given in the order of the parts."""
    in_order = _picker([numbers.index(number) for number in range(len(numbers))])
    return lambda data: in_order([vector for part in parts for vector in part(data)])


def _picker(items: Sequence[int | slice]) -> Callable[[Any], tuple[Any, ...]]:
    """What takes these items of something, as a tuple, in one call."""
    first, *more = items
    pick: Callable[[Any], Any] = itemgetter(*items)
    return pick if more else lambda of: (of[first],)

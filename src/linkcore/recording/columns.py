"""Columns of packets, as arrays in the byte order and the number types of this computer."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from ..wire.fields import NOT_A_CODE, Coded, Mask64, OpenInt, Raw
from ..wire.layout import NATIVE_DOUBLE, WIRE_DOUBLE, Layout, Place
from ..wire.packet import State
from .packets import Part

#: Number of packets whose columns are made together. Their bytes must stay in the cache of a processor.
_BLOCK = 512
#: Size of a cache line in bytes; every column begins at a cache line.
_LINE = 64


#: Function that returns the values of some fields in the packets `start` to `stop`, as one array for each field.
_Raw = Callable[[int, int], list[NDArray[Any]]]


class Column(NamedTuple):
    """Description of a column.

    Attributes:
        name: Name of the field.
        unit: Unit of the values; "" for none.
        doc: Meaning of the field.
        width: Number of elements in each row; None for a single value.
        dtype: Type of the values.
        meaning: Enumeration of the values; None for plain numbers.
    """

    name: str
    unit: str = ""
    doc: str = ""
    width: int | None = None
    dtype: np.dtype[Any] = np.dtype("f8")
    meaning: type[OpenInt] | None = None

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of each row."""
        return () if self.width is None else (self.width,)


def is_continuous(column: Column) -> bool:
    """Whether values between two rows can be interpolated.

    Codes, masks, counters and text cannot be interpolated.
    """
    return column.dtype.kind == "f"


class Columns(Protocol):
    """Source of the columns of a table."""

    @property
    def known(self) -> Mapping[str, Column]:
        """All columns by name."""

    def read(self, names: Sequence[str], begin: int, end: int) -> dict[str, NDArray[Any]]:
        """Return the rows `begin` to `end` of some columns.

        Each array has `end - begin` rows of the column's shape.
        """


class ArrayColumns:
    """Columns that exist as arrays."""

    def __init__(self, known: Mapping[str, Column], arrays: Mapping[str, NDArray[Any]]) -> None:
        self.known = known
        self._arrays = arrays

    def read(self, names: Sequence[str], begin: int, end: int) -> dict[str, NDArray[Any]]:
        """See `Columns`."""
        return {name: self._arrays[name][begin:end] for name in names}


def columns_of(states: Sequence[State]) -> ArrayColumns:
    """Return the columns of decoded packets. Use this for packets with text, which have different sizes."""
    known = _common([state._layout for state in states])
    arrays = {}
    for name, column in known.items():
        array = np.empty((len(states), *column.shape), column.dtype)
        for row, state in enumerate(states):
            array[row] = getattr(state, name)
        arrays[name] = array
    return ArrayColumns(known, arrays)


class JoinedColumns:
    """Columns of several sources with the same number of rows, named after their source: ``joint_data.q_actual``."""

    def __init__(self, sources: Mapping[str, Columns]) -> None:
        self._sources = sources
        self.known = {
            f"{first}.{name}": column._replace(name=f"{first}.{name}")
            for first, source in sources.items()
            for name, column in source.known.items()
        }

    def read(self, names: Sequence[str], begin: int, end: int) -> dict[str, NDArray[Any]]:
        """See `Columns`."""
        found: dict[str, NDArray[Any]] = {}
        for first, source in self._sources.items():
            mine = [name.partition(".")[2] for name in names if name.partition(".")[0] == first]
            found.update((f"{first}.{name}", array) for name, array in source.read(mine, begin, end).items())
        return {name: found[name] for name in names}


class PacketColumns:
    """Columns read from the bytes of packets without text, which may have several layouts.

    There is a column for each field that all layouts have. If the types of a field differ, as for the robot modes of
    two generations, its values are plain numbers.
    """

    def __init__(self, parts: Sequence[Part]) -> None:
        self._parts = list(parts)
        self.known = _common([part.layout for part in self._parts])
        #: Fields that only some of the layouts have.
        self.partial = sorted({name for part in self._parts for name in part.layout.places} - self.known.keys())
        self._ends = np.cumsum([len(part) for part in self._parts]).tolist()

    def read(self, names: Sequence[str], begin: int, end: int) -> dict[str, NDArray[Any]]:
        """See `Columns`."""
        made = _allocated({name: self.known[name] for name in names}, end - begin)
        for part, first, last, at in self._pieces(begin, end) if names else ():
            places = [part.layout.places[name] for name in names]
            columns = [made[name][at : at + last - first] for name in names]
            stored = [_as_stored(place, column) for place, column in zip(places, columns, strict=True)]
            raw = (_cells if part.layout.of_cells else _mixed)(part, places)
            for start in range(first, last, _BLOCK):
                stop = min(start + _BLOCK, last)
                for to, values in zip(stored, raw(start, stop), strict=True):
                    to[start - first : stop - first] = values
            for place, column in zip(places, columns, strict=True):
                _read_in_place(place, column)
        return made

    def by_layout(self, begin: int, end: int) -> list[tuple[PacketColumns, int, int]]:
        """Return (columns, first row, row after the last row) for each layout."""
        return [
            (PacketColumns([part.sliced(first, last)]), begin + at, begin + at + last - first)
            for part, first, last, at in self._pieces(begin, end)
        ]

    def _pieces(self, begin: int, end: int) -> Iterator[tuple[Part, int, int, int]]:
        """Yield (part, first packet, packet after the last one, first row) for each part that has some of the rows."""
        for part, stop in zip(self._parts, self._ends, strict=True):
            start = stop - len(part)
            first, last = max(begin, start), min(end, stop)
            if first < last:
                yield part, first - start, last - start, first - begin


def _allocated(columns: Mapping[str, Column], rows: int) -> dict[str, NDArray[Any]]:
    """Allocate the memory for columns in one piece.

    The system provides large pieces in pages of 2 MB. Single columns are too small for this, and allocating them in
    many small pages takes half as long as filling them.
    """
    sizes = [math.prod((rows, *column.shape)) * column.dtype.itemsize for column in columns.values()]
    starts = [0, *itertools.accumulate(size + -size % _LINE for size in sizes)]
    room = np.empty(starts[-1], np.uint8)
    return {
        name: np.ndarray((rows, *column.shape), column.dtype, room, start)
        for (name, column), start in zip(columns.items(), starts, strict=False)
    }


def _cells(part: Part, places: Sequence[Place]) -> _Raw:
    """Return the reader for packets that consist only of 8-byte numbers, in the byte order of this machine.

    The bytes of all numbers, from the first to the last requested number, are swapped at once. Numpy would take longer
    to swap each field separately, for example six numbers of each packet.
    """
    begin = min(place.offset for place in places)
    end = max(place.offset + place.stride * ((place.count or 1) - 1) + place.width for place in places)
    wire = np.dtype((WIRE_DOUBLE, ((end - begin) // 8,)))
    cells = np.empty((_BLOCK, (end - begin) // 8), NATIVE_DOUBLE)
    values = []
    for place in places:
        first, step = (place.offset - begin) // 8, place.stride // 8
        at = first if place.count is None else slice(first, first + place.count * step, step)
        values.append((cells.view(np.uint64) if place.shape is Mask64 else cells)[:, at])

    def raw(start: int, stop: int) -> list[NDArray[Any]]:
        cells[: stop - start] = part.view(start, stop, begin, wire)
        return [value[: stop - start] for value in values]

    return raw


def _mixed(part: Part, places: Sequence[Place]) -> _Raw:
    """Return the reader for packets with numbers of several sizes, in the byte order of the wire."""

    def raw(start: int, stop: int) -> list[NDArray[Any]]:
        packets = part.view(start, stop, 0, part.layout.dtype)
        return [(packets if group is None else packets[group])[name] for group, name in names]

    names = [(place.field.interleave, place.field.name) for place in places]
    return raw


def _as_stored(place: Place, column: NDArray[Any]) -> NDArray[Any]:
    """Return a view of the column with the type of the numbers on the wire."""
    return column.view(NATIVE_DOUBLE) if _is_code_in_float(place, column) else column


def _read_in_place(place: Place, column: NDArray[Any]) -> None:
    """Convert a column of numbers from the wire, in place, to the values that users get."""
    if place.shape is Mask64:
        # A mask might be coded as an IEEE double of the same value; see `Mask64`.
        if column.max() >> np.uint64(48):
            odd = np.flatnonzero(column >> np.uint64(48))
            column[odd] = [Mask64.read(each) for each in column[odd].tolist()]
    elif _is_code_in_float(place, column):
        numbers = column.view(NATIVE_DOUBLE)
        # A double that is not a 32-bit integer becomes a different number here.
        with np.errstate(invalid="ignore"):
            codes = numbers.astype(np.int32)
        is_none = codes != numbers
        column[:] = codes
        if is_none.any():
            column[is_none] = NOT_A_CODE


def _is_code_in_float(place: Place, column: NDArray[Any]) -> bool:
    return place.number is not None and place.number.kind[0] == "f" and column.dtype == np.int64


def _column(place: Place) -> Column:
    field, shape = place.field, place.shape
    element: Any = getattr(shape, "element", shape)
    meaning = getattr(element, "meaning", None)
    if isinstance(shape, Raw):
        dtype = np.dtype(object)
    elif shape is Mask64:
        dtype = np.dtype("u8")
    elif meaning is bool:
        dtype = np.dtype(bool)
    elif isinstance(element, Coded):
        dtype = np.dtype("i8")
    else:
        assert place.number is not None, "everything else is a number"
        # Floats of four bytes are also converted to float64, which is exact.
        dtype = np.dtype("f8" if place.number.kind[0] == "f" else place.number.kind)
    is_enumeration = isinstance(meaning, type) and issubclass(meaning, OpenInt)
    return Column(field.name, field.unit, field.doc, place.count, dtype, meaning if is_enumeration else None)


def _common(layouts: Sequence[Layout]) -> dict[str, Column]:
    """Return the columns that all layouts have."""
    every = [{name: _column(place) for name, place in layout.places.items()} for layout in dict.fromkeys(layouts)]
    if not every:
        return {}
    found = {}
    for name, column in every[0].items():
        others = [columns[name] for columns in every if name in columns]
        if len(others) == len(every) and all(other.width == column.width for other in others):
            dtype = np.result_type(*(other.dtype for other in others))
            is_same = all(other.meaning is column.meaning for other in others)
            found[name] = column._replace(dtype=dtype, meaning=column.meaning if is_same else None)
    return found

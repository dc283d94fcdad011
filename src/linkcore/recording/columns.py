"""Columns of packets as arrays in the byte order and the types of this machine."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from ..wire.layout import NATIVE_DOUBLE, WIRE_DOUBLE, Layout, Place
from ..wire.packet import State
from ..wire.shapes import NOT_A_CODE, Coded, Mask64, OpenInt, Raw
from .packets import Part

__all__ = ["ArrayColumns", "Column", "Columns", "JoinedColumns", "PacketColumns", "columns_of", "is_continuous"]

#: Packets whose columns are made together: so few that their bytes stay in the cache of a processor.
_BLOCK = 512
#: Bytes that a processor takes from memory at a time; every column begins with such a line.
_LINE = 64


#: Makes the values of some fields in packets `start` to `stop`, one array for each field.
_Raw = Callable[[int, int], list[NDArray[Any]]]


class Column(NamedTuple):
    """What is known of a column.

    Attributes:
        name: of the field.
        unit: of its values; "" for none.
        doc: what it means.
        width: elements in each row, or None for one that is no array.
        dtype: of its values.
        meaning: the enumeration of which the values are the numbers, or None.
    """

    name: str
    unit: str = ""
    doc: str = ""
    width: int | None = None
    dtype: np.dtype[Any] = np.dtype("f8")
    meaning: type[OpenInt] | None = None

    @property
    def shape(self) -> tuple[int, ...]:
        """Of each row."""
        return () if self.width is None else (self.width,)


def is_continuous(column: Column) -> bool:
    """Whether what is between two values can be computed: not of codes, masks, counters and text."""
    return column.dtype.kind == "f"


class Columns(Protocol):
    """The source of a table's columns."""

    @property
    def known(self) -> Mapping[str, Column]:
        """What there is, by name."""

    def read(self, names: Sequence[str], begin: int, end: int) -> dict[str, NDArray[Any]]:
        """The rows `begin` to `end` of some columns, each (end - begin,) and the shape of its rows."""


class ArrayColumns:
    """Columns that are arrays already."""

    def __init__(self, known: Mapping[str, Column], arrays: Mapping[str, NDArray[Any]]) -> None:
        self.known = known
        self._arrays = arrays

    def read(self, names: Sequence[str], begin: int, end: int) -> dict[str, NDArray[Any]]:
        """See `Columns`."""
        return {name: self._arrays[name][begin:end] for name in names}


def columns_of(states: Sequence[State]) -> ArrayColumns:
    """The columns of packets that have been decoded: for those with text, whose sizes vary."""
    known = _common([state._layout for state in states])
    arrays = {}
    for name, column in known.items():
        array = np.empty((len(states), *column.shape), column.dtype)
        for row, state in enumerate(states):
            array[row] = getattr(state, name)
        arrays[name] = array
    return ArrayColumns(known, arrays)


class JoinedColumns:
    """The columns of several sources with as many rows, each under a name of its own: ``joint_data.q_actual``."""

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
    """Columns out of the bytes of packets without text, of one layout or of several.

    Those that every layout has are columns. Where the types differ, as those of robot modes of two generations, they
    are numbers.
    """

    def __init__(self, parts: Sequence[Part]) -> None:
        self._parts = list(parts)
        self.known = _common([part.layout for part in self._parts])
        #: fields that only some of the layouts have
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
        """The rows of each layout by themselves: the columns, and the rows in which they begin and end."""
        return [
            (PacketColumns([part.sliced(first, last)]), begin + at, begin + at + last - first)
            for part, first, last, at in self._pieces(begin, end)
        ]

    def _pieces(self, begin: int, end: int) -> Iterator[tuple[Part, int, int, int]]:
        """Of each part that has some of the rows: the first and the last of them in it, and the row they begin at."""
        for part, stop in zip(self._parts, self._ends, strict=True):
            start = stop - len(part)
            first, last = max(begin, start), min(end, stop)
            if first < last:
                yield part, first - start, last - start, first - begin


def _allocated(columns: Mapping[str, Column], rows: int) -> dict[str, NDArray[Any]]:
    """Room for columns, in one piece.

    The system gives it in pages of 2 MB, which columns by themselves are too short for: to be given as many small ones
    takes half as long as to fill them.
    """
    sizes = [math.prod((rows, *column.shape)) * column.dtype.itemsize for column in columns.values()]
    starts = [0, *itertools.accumulate(size + -size % _LINE for size in sizes)]
    room = np.empty(starts[-1], np.uint8)
    return {
        name: np.ndarray((rows, *column.shape), column.dtype, room, start)
        for (name, column), start in zip(columns.items(), starts, strict=False)
    }


def _cells(part: Part, places: Sequence[Place]) -> _Raw:
    """Of packets of 8-byte numbers throughout: the values in the byte order of this machine.

    All numbers from the first that is wanted to the last are swapped at once: numpy takes longer for the fields one by
    one, six numbers of each packet at a time.
    """
    begin = min(place.offset for place in places)
    end = max(place.offset + place.stride * ((place.count or 1) - 1) + place.width for place in places)
    wire = np.dtype((WIRE_DOUBLE, (end - begin) // 8))
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
    """Of packets of several widths: the values as they lie on the wire."""

    def raw(start: int, stop: int) -> list[NDArray[Any]]:
        packets = part.view(start, stop, 0, part.layout.dtype)
        return [(packets if group is None else packets[group])[name] for group, name in names]

    names = [(place.field.interleave, place.field.name) for place in places]
    return raw


def _as_stored(place: Place, column: NDArray[Any]) -> NDArray[Any]:
    """A column as it takes the numbers of the wire."""
    return column.view(NATIVE_DOUBLE) if _is_code_in_float(place, column) else column


def _read_in_place(place: Place, column: NDArray[Any]) -> None:
    """Make the values that users hold of the numbers that a column has taken."""
    if place.shape is Mask64:
        # A mask may be held as an IEEE double of the same value; see `Mask64`.
        if column.max() >> np.uint64(48):
            odd = np.flatnonzero(column >> np.uint64(48))
            assert Mask64.read is not None, "it is a mask because it is read so"
            column[odd] = [Mask64.read(each) for each in column[odd].tolist()]
    elif _is_code_in_float(place, column):
        numbers = column.view(NATIVE_DOUBLE)
        # What is no whole number of 32 bits becomes some other number.
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
        # Floats of four bytes too are handed out as float64; that is exact.
        dtype = np.dtype("f8" if place.number.kind[0] == "f" else place.number.kind)
    is_enumeration = isinstance(meaning, type) and issubclass(meaning, OpenInt)
    return Column(field.name, field.unit, field.doc, place.count, dtype, meaning if is_enumeration else None)


def _common(layouts: Sequence[Layout]) -> dict[str, Column]:
    """The columns that all layouts have."""
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

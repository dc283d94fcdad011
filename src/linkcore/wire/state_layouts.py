"""Layouts of one packet class: the decoder for each layout, and the selection of a layout by version and size."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cache, cached_property, partial
from operator import itemgetter
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import PacketError, unraised
from .fields import Field, Header, Shape, Version, parse_version, version_text
from .layout import NATIVE_DOUBLE, WIRE_DOUBLE, Layout, Place

if TYPE_CHECKING:
    from ..clock import Stamp

#: Number of doubles in vectors above which numpy swaps all bytes faster than struct unpacks and packs the packet.
_MANY_DOUBLES = 32

#: Reader of one field: its unpacker, its offset, and a function from its numbers to the user's value, or None.
_Single = tuple[Callable[[bytes, int], Any], int, Callable[[Any], Any] | None]


class StateLayout(Layout):
    """Layout with the typed values of a packet class.

    A state consists of its bytes. Decoding a packet only checks its size, and a field is read when it is accessed. If
    the packet contains text, whose place must be found, the whole packet is read when it is decoded.

    Attributes:
        packet: The packet class, derived from `linkcore.wire.state.State`.
        decode: ``decode(data, stamp=None)`` returns the state of one complete packet, header included. Raises
            `PacketError`.
        singles: Reader of each field of the class; a field that is not sent is read as None.
        vectors: For each field of the class that is an array of floats, its items in the array that `swap` makes.
        swap: ``swap(state)`` returns all arrays of floats as one read-only float64 array, which the state keeps.
        arrays: Name of each array of floats, by its first item in the array that `swap` makes.
    """

    decode: Callable[..., Any]
    swap: Callable[[Any], Any]

    def __init__(self, packet: type[Any], *args: Any, has_text: bool, **kwargs: Any) -> None:
        super().__init__(packet.__name__, *args, names=tuple(packet.FIELDS), **kwargs)
        self.packet = packet
        self.singles: list[_Single] = []
        self.vectors: list[slice | None] = []
        self._reads_whole = has_text
        if not has_text:
            shapes = [field.shape for field in packet.FIELDS.values()]
            places = [self.places.get(name) for name in self.names]
            self.singles = [_single(*each) for each in zip(shapes, places, strict=True)]
            arrays = [place for place in places if place is not None and is_array_of_floats(place.shape)]
            are_doubles = all(place.width == 8 and place.field.interleave is None for place in arrays)
            if are_doubles and sum(place.count or 1 for place in arrays) >= _MANY_DOUBLES:
                self.swap, items = _swap_of_bytes(arrays)
            else:
                self.swap, items = _swap_of_numbers(self), {place: place.at for place in arrays}
            self.vectors = [None if place is None else items.get(place) for place in places]  # type: ignore[misc]
        self.decode = self._decoder()

    @cached_property
    def arrays(self) -> dict[int, str]:
        return {items.start: name for name, items in zip(self.names, self.vectors, strict=True) if items is not None}

    def _decoder(self) -> Callable[..., Any]:
        packet, size, new = self.packet, self.size, object.__new__
        values = self.values if self._reads_whole else None

        def decode(data: bytes, stamp: Stamp | None = None) -> Any:
            if len(data) < size:
                raise self.too_short(data)
            state = new(packet)
            state._data = data
            state._layout = self
            state._stamp = stamp
            state._values = None if values is None else values(data)
            return state

        return decode

    def values(self, data: bytes) -> tuple[Any, ...] | None:
        """Return the values that a state stores when it is decoded.

        They are the values of all fields if there is text, or else None.

        Raises:
            PacketError: If there is text, and the packet cannot hold it.
        """
        if not self._reads_whole:
            return None
        found = {}
        for place, _, _, values in self.stretches(data):
            meaning = _meaning(place.shape)
            value = values[0] if place.count is None else values
            found[place.field.name] = value if meaning is None else meaning(value)
        return tuple(map(found.get, self.names))


def is_array_of_floats(shape: Shape) -> bool:
    """Whether users get a field of this shape as a float64 array."""
    return shape.count is not None and shape.read is None and shape.number is not None and shape.number.kind[0] == "f"


def _swap_of_bytes(arrays: Iterable[Place]) -> tuple[Callable[[Any], Any], dict[Place, int | slice]]:
    """Return `StateLayout.swap` for many doubles, and the items of each place in the array.

    At 500 Hz and with cold caches, numpy takes 20 to 30 us for a packet, in the thread that reads the stream. A
    subscriber that reads a few numbers needs no array. So the bytes are swapped when the first array is accessed.
    """
    # Doubles can be swapped together if their distance is a multiple of 8 bytes.
    aligned: dict[int, list[Place]] = {}
    for place in arrays:
        aligned.setdefault(place.offset % 8, []).append(place)
    items: dict[Place, int | slice] = {}
    stretches, before = [], 0
    for places in aligned.values():
        places.sort(key=lambda place: place.offset)
        start = places[0].offset
        count = (places[-1].offset + places[-1].size - start) // 8
        stretches.append((count, start))
        for place in places:
            begin = before + (place.offset - start) // 8
            items[place] = slice(begin, begin + (place.count or 1))
        before += count
    (count, start), *others = stretches
    frombuffer, concatenate = np.frombuffer, np.concatenate

    def swap(state: Any) -> Any:
        data = state._data
        cells = frombuffer(data, WIRE_DOUBLE, count, start).astype(NATIVE_DOUBLE)
        if others:
            cells = concatenate([cells, *(frombuffer(data, WIRE_DOUBLE, *other) for other in others)])
        cells.setflags(False)  # type: ignore[call-arg]  # write=False, but a keyword takes longer
        state._values = cells
        return cells

    return swap, items


def _swap_of_numbers(layout: Layout) -> Callable[[Any], Any]:
    """Return `StateLayout.swap` for a few floats of any size and order, which converts all numbers to doubles.

    Floats of four bytes also become float64, which is exact. The conversion through bytes takes a third of the time of
    `np.array`.
    """
    pack = struct.Struct(f"={sum(place.count or 1 for place in layout.places.values())}d").pack
    unpack_from, frombuffer = layout.struct.unpack_from, np.frombuffer  # type: ignore[union-attr]  # there is no text

    def swap(state: Any) -> Any:
        state._values = cells = frombuffer(pack(*unpack_from(state._data)))
        return cells

    return swap


def _single(shape: Shape, place: Place | None) -> _Single:
    """Return an entry of `StateLayout.singles` for a field that the class declares with `shape`."""
    if place is None:
        return _nothing, 0, None if shape.count is None else itemgetter(0)
    assert place.number is not None, "there is no text"
    code = place.number.code
    between = f"{place.stride - place.width}x"  # bytes of other fields that are interleaved with it
    form = f">{f'{code}{between}' * ((place.count or 1) - 1)}{code}"
    return _unpacker(form), place.offset, _meaning(place.shape)


def _nothing(data: bytes, offset: int) -> tuple[None]:
    """Unpack a field that is not sent."""
    return (None,)


@cache
def _unpacker(form: str) -> Callable[[bytes, int], Any]:
    return struct.Struct(form).unpack_from


@cache
def _meaning(shape: Shape) -> Callable[[Any], Any] | None:
    """Return a function from the numbers or bytes of a field to the user's value.

    Return None if they are the same.
    """
    read, number = shape.read, shape.number
    if shape.count is None:
        return read
    if read is not None:
        return lambda numbers: tuple(map(read, numbers))
    assert number is not None, "there are no arrays of text"
    dtype = np.dtype(np.float64 if number.kind[0] == "f" else number.kind)
    return lambda numbers: _read_only(np.array(numbers, dtype))


def _read_only(array: Any) -> Any:
    array.flags.writeable = False
    return array


class StateLayouts:
    """All distinct orders of fields that any version sends.

    The layouts are made at the first use, and only once.

    Args:
        packet: Packet class, derived from `linkcore.wire.state.State`.
        header: See `Layout`.
        constants: See `Layout`.
        reorder: ``((3, 0), names)`` if versions before 3.0 send the fields in this other order, or None.
        has_text: Whether a field is text.

    Attributes:
        blocks: Names of the fields that show whether the optional block is sent.
    """

    def __init__(
        self,
        packet: type[Any],
        header: Header,
        constants: Mapping[str, int],
        reorder: tuple[Version, Sequence[str]] | None,
        *,
        has_text: bool,
    ) -> None:
        self._name = packet.__name__
        self._fields = packet.FIELDS
        self._lower = partial(StateLayout, packet, header=header, constants=constants, has_text=has_text)
        self._reorder = reorder
        self.blocks = {field.block for field in self._fields.values() if field.block is not None}
        self._chosen: dict[tuple[Version, bool], StateLayout] = {}  # results of `of`
        # (size, version) -> the layouts that fit, and the decoder if size and version are enough to choose it
        self._known: dict[tuple[int, Version | None], tuple[list[StateLayout], Callable[..., Any] | None]] = {}

    @cached_property
    def all(self) -> tuple[StateLayout, ...]:
        """All distinct layouts, with the oldest first."""
        return tuple(dict.fromkeys(self._by_version.values()))

    @cached_property
    def _by_version(self) -> dict[tuple[Version, bool], StateLayout]:
        """(version, whether it has the block) -> layout, for each version at which the layout changes."""
        steps = {step for field in self._fields.values() for step in field.steps}
        if self._reorder is not None:
            steps.add(self._reorder[0])
        known: dict[Any, StateLayout] = {}
        found = {}
        for version in sorted(steps) or [(0, 0)]:
            for has_block in (False, True) if self.blocks else (False,):
                fields = self._sent(version, has_block)
                if not fields and self._fields:
                    continue
                key = tuple((field.name, id(shape)) for field, shape in fields)
                if key not in known:
                    known[key] = self._lower(fields, first=version, has_block=has_block)
                found[version, has_block] = known[key]
        return found

    def _sent(self, version: Version, has_block: bool) -> list[tuple[Field, Shape]]:
        order: Sequence[str] = list(self._fields)
        if self._reorder is not None and version < self._reorder[0]:
            order = self._reorder[1]
        shapes = ((field, field.shape_in(version)) for field in map(self._fields.__getitem__, order))
        return [(field, shape) for field, shape in shapes if shape is not None and (has_block or field.block is None)]

    def of(self, version: str | Version | None = None, values: Mapping[str, Any] | None = None) -> StateLayout:
        """Return the layout that `version` sends, or the newest one; with its block if `values` requires it.

        Raises:
            PacketError: If this version does not send the packet.
        """
        has_block = any((values or {}).get(block) for block in self.blocks)
        if version is None:
            return next(layout for layout in reversed(self.all) if layout.has_block == has_block)
        version = parse_version(version)
        found = self._chosen.get((version, has_block))
        if found is None:
            steps = [step for step, block in self._by_version if block == has_block and step <= version]
            if not steps or (self._fields and not self._sent(version, has_block)):
                raise PacketError("this firmware does not send it", packet=self._name, version=version_text(version))
            found = self._chosen[version, has_block] = self._by_version[max(steps), has_block]
        return found

    def fitting(self, size: int, version: Version | None = None) -> list[StateLayout]:
        """Return the layouts that a packet of `size` bytes might have, with the best one first.

        A layout of exactly this size is the best, then the longest layout that fits; the remaining bytes are the tail.
        With a version, its own layout is the smallest possible one, and only layouts that extend it are possible,
        because newer releases append fields. If a release has removed fields, its first builds might still send them.
        So a larger layout of exactly this size is also possible if it is of the same generation.

        Raises:
            PacketError: If the packet is shorter than the layout of its version, or than every layout.
        """
        candidates = list(self.all)
        least = min(layout.size for layout in candidates)
        if version is not None:
            own = [self.of(version)]
            if self.blocks:
                own.append(self.of(version, dict.fromkeys(self.blocks, True)))
            least = own[0].size
            candidates = [
                layout
                for layout in candidates
                if any(layout.fields[: len(mine.fields)] == mine.fields for mine in own)
                or (layout.first[0] == version[0] and layout.size == size > least and not layout.has_text)
            ]
        fits = [layout for layout in candidates if layout.size <= size]
        if not fits:
            raise PacketError(
                "the packet is too short",
                packet=self._name,
                version=None if version is None else version_text(version),
                expected=least,
                actual=size,
                offset=size,
            )
        return sorted(fits, key=lambda layout: (layout.size == size, layout.size), reverse=True)

    def decode(self, data: bytes, version: Version | None = None, stamp: Stamp | None = None) -> Any:
        """Return the typed state of one complete packet, header included.

        Raises:
            PacketError: If no layout can hold it.
        """
        key = (len(data), version)
        known = self._known.get(key)
        if known is None:
            known = self.fitting(*key), self.decoder(*key)
            if len(self._known) < 256:  # sizes come from the wire, so the number of entries must be limited
                self._known[key] = known
        fits, decode = known
        if decode is not None:
            return decode(data, stamp)
        failure: PacketError | None = None
        for layout in fits:
            try:
                state = layout.decode(data, stamp)
            except PacketError as error:
                failure = failure or unraised(error)  # the traceback of `error` would refer to this frame
                continue
            if all(bool(getattr(state, block)) == layout.has_block for block in self.blocks):
                return state
        if failure is not None:
            try:
                raise failure
            finally:
                del failure  # breaks the reference cycle between the error and this frame
        return fits[0].decode(data, stamp)

    def decoder(self, size: int, version: Version | None = None) -> Callable[..., Any] | None:
        """Return the decoder of packets of this size; None if the choice depends on their content.

        Raises:
            PacketError: If no layout can hold such a packet.
        """
        fits = self.fitting(size, version)
        by_text = fits[0].has_text and len(fits) > 1
        by_block = len({layout.has_block for layout in fits}) > 1
        return None if by_text or by_block else fits[0].decode

"""A construct schema turned into what runs: size table, fast decoder, encoder, numpy dtype.

A `Layout` is one order of fields on the wire. Everything in it is derived from the declared shapes,
never written twice. Construct stays the slow oracle: `Layout.parse_slowly` gives the same values
through construct alone, and a property test holds the two equal for every layout.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import groupby
from typing import TYPE_CHECKING, Any, NamedTuple

import construct
import numpy as np

from ..errors import BadValue, PacketError
from .shapes import Raw, Shape
from .version import Since, Version, version_text

if TYPE_CHECKING:
    from ..stamp import Stamp
    from .packet import State

__all__ = ["Layout", "Place", "Row", "Wire", "header_rows"]

_WIRE_DOUBLE = np.dtype(">f8")
_NATIVE_DOUBLE = np.dtype("=f8")
_MANY_CELLS = 32


@dataclass(frozen=True)
class Wire:
    """What is declared of one field; see `linkcore.wire.packet.wire`."""

    name: str
    shape: Any
    unit: str
    doc: str
    since: Since
    until: Version | None
    before: tuple[Version, Any] | None
    interleave: str | None
    block: str | None

    def shape_in(self, version: Version) -> Any | None:
        """The shape that `version` sends, or None where it does not send the field."""
        if version not in self.since or (self.until is not None and version >= self.until):
            return None
        if self.before is not None and version < self.before[0]:
            return self.before[1]
        return self.shape


class Row(NamedTuple):
    """One line of a dissection: a stretch of bytes and what it means."""

    offset: int
    data: bytes
    name: str
    value: Any
    unit: str
    doc: str


def header_rows(header: Any, data: bytes) -> Iterator[Row]:
    """The parts of the header that `data` begins with."""
    offset = 0
    for part in header.subcons:
        raw = data[offset : offset + part.sizeof()]
        yield Row(offset, raw, part.name, part.parse(raw), "B" if part.name == "size" else "", "header")
        offset += len(raw)


class Place:
    """Where one field lies in one layout, and how its bytes become a value."""

    def __init__(self, wire: Wire, shape: Any) -> None:
        self.wire = wire
        self.shape = shape
        self.count: int | None = None
        if isinstance(shape, construct.Array):
            self.count, shape = shape.count, shape.subcon
        self.element: Shape | None = shape if isinstance(shape, Shape) else None
        inner = shape.subcon if self.element is not None else shape
        #: struct's letter, or None for bytes of no fixed number.
        self.code: str | None = inner.fmtstr[-1] if isinstance(inner, construct.FormatField) else None
        self.width = inner.sizeof() if self.code is not None else 0
        #: numpy's name of one element, such as "f8". struct's letters will not do: numpy's "L" has 8 bytes on Linux.
        self.kind = "" if self.code is None else f"{_numpy_kind(self.code)}{self.width}"
        # Filled in by the layout, which alone knows the neighbours.
        self.offset = 0
        self.stride = self.width
        self.at: int | slice = 0

    @property
    def size(self) -> int:
        """Bytes of the field; of text, the bytes it has at least."""
        if isinstance(self.element, Raw):
            return 0 if self.element.prefix is None else int(self.element.prefix.sizeof())
        return self.width * (self.count or 1)

    @cached_property
    def default(self) -> Any:
        """What the encoder sends of a field that it is not told of."""
        zero: Any = b"" if self.code is None else 0
        zero = zero if self.element is None else self.element.read(zero)
        return zero if self.count is None else [zero] * self.count

    def reader(self, of_cells: bool) -> Callable[[Any], Any]:
        """A function from the unpacked values of a packet to the value of this field."""
        at, element = self.at, self.element
        if of_cells and self.code == "Q":
            read_mask = element.read if element is not None else int
            return lambda cells: read_mask(cells.view(np.uint64).item(at))
        if of_cells:
            if self.count is None:
                if element is None:
                    return lambda cells: cells.item(at)
                read = element.read
                return lambda cells: read(cells.item(at))
            if element is None:
                return lambda cells: cells[at]
            read = element.read
            return lambda cells: tuple(map(read, cells[at].tolist()))
        if self.count is None:
            if element is None:
                return lambda values: values[at]
            read = element.read
            return lambda values: read(values[at])
        if element is None:
            # Floats of four bytes too are handed out as float64; that is exact.
            native = _NATIVE_DOUBLE if self.kind[0] == "f" else np.dtype(self.kind)

            def read_vector(values: tuple[Any, ...]) -> Any:
                vector = np.array(values[at], native)
                vector.setflags(write=False)
                return vector

            return read_vector
        read = element.read
        return lambda values: tuple(map(read, values[at]))

    def raw(self, value: Any) -> list[Any]:
        """The struct values of `value`, one per element.

        Raises:
            BadValue: wrong number of elements, or not a number.
        """
        name = self.wire.name
        if isinstance(value, np.ndarray):
            value = value.tolist()
        if self.count is None:
            elements = [value]
        elif isinstance(value, Sequence) and len(value) == self.count:
            elements = list(value)
        else:
            raise BadValue(f"{name}: expected {self.count} elements, got {value!r}")
        try:
            if self.element is not None:
                return [self.element.write(element) for element in elements]
            return [element + 0 for element in elements]
        except (TypeError, ValueError, OverflowError) as error:
            raise BadValue(f"{name}: {value!r} cannot be sent ({error})") from None


class Layout:
    """One order of fields on the wire.

    Attributes:
        packet: the typed class whose layout this is.
        first: the first version that has it.
        places: name -> `Place`, in wire order.
        size: bytes of the packet, header included; with text in it, the least number of bytes.
        has_text: True if the number of bytes varies.
        decode: ``decode(data, stamp=None) -> State``, the fast decoder. `data` is one whole packet,
            header included, as `bytes`. Raises `PacketError`.
    """

    decode: Callable[..., Any]

    def __init__(
        self,
        packet: type[State],
        first: Version,
        fields: Sequence[tuple[Wire, Any]],
        header: Any,
        constants: Mapping[str, int],
        has_block: bool,
    ) -> None:
        self.packet = packet
        self.first = first
        self.header = header
        self.constants = constants
        self.has_block = has_block
        self.places = {wire.name: Place(wire, shape) for wire, shape in fields}
        self.fields = tuple((name, place.shape) for name, place in self.places.items())
        self._arrange()
        cells = sum(place.count or 1 for place in self.places.values())
        uniform = all(place.width == 8 and place.code in ("d", "Q") for place in self.places.values())
        #: 8-byte cells throughout, and enough of them that numpy unpacks them quicker than struct
        self.of_cells = uniform and cells >= _MANY_CELLS
        self.readers = [
            self.places[name].reader(self.of_cells) if name in self.places else _not_sent for name in packet.FIELDS
        ]
        #: where the cells of each field of the class are; what is not sent has none
        self.cells_at = [self.places[name].at if name in self.places else None for name in packet.FIELDS]
        if self.has_text:
            self.decode = self._text_decoder()
        elif self.of_cells:
            self.decode = self._cell_decoder()
        else:
            self.decode = self._struct_decoder()

    def _arrange(self) -> None:
        """Give every place its offset and its index among the unpacked values."""
        offset = int(self.header.sizeof())
        self._runs: list[list[Place]] = []
        index = 0
        codes = [f">{offset}x"]
        for key, members in groupby(self.places.values(), key=lambda place: place.wire.interleave):
            group = list(members)
            if key is None:
                for place in group:
                    place.offset = offset
                    place.at = index if place.count is None else slice(index, index + place.count)
                    index += place.count or 1
                    offset += place.size
                    codes.append(f"{place.count or 1}{place.code}" if place.code is not None else "|")
                    self._runs.append([place])
                continue
            (count,) = {place.count or 1 for place in group}
            stride = sum(place.width for place in group)
            step = len(group)
            for number, place in enumerate(group):
                place.offset, place.stride = offset, stride
                place.at = slice(index + number, index + number + step * (count - 1) + 1, step)
                offset += place.width
            offset += stride * (count - 1)
            index += step * count
            codes.append("".join(f"{place.code}" for place in group) * count)
            self._runs.append(group)
        self.size = offset
        self.has_text = any(place.code is None for place in self.places.values())
        self._struct = None if self.has_text else struct.Struct("".join(codes))

    def __repr__(self) -> str:
        version = version_text(self.first)
        return f"<Layout {self.packet.__name__} since {version}, {self.size}{'+' if self.has_text else ''} bytes>"

    # -- from the wire -------------------------------------------------------------------------

    def _too_short(self, data: bytes) -> PacketError:
        return PacketError(
            "packet too short",
            packet=self.packet.__name__,
            version=version_text(self.first),
            expected=self.size,
            actual=len(data),
            offset=len(data),
        )

    def _cell_decoder(self) -> Callable[..., Any]:
        """All 8-byte cells: swap the whole packet once and hand out views of it."""
        packet = self.packet
        start = int(self.header.sizeof())
        count = (self.size - start) // 8
        new, frombuffer = object.__new__, np.frombuffer

        def decode(data: bytes, stamp: Stamp | None = None) -> Any:
            state = new(packet)
            state._data = data
            state._layout = self
            state._stamp = stamp
            try:
                cells = frombuffer(data, _WIRE_DOUBLE, count, start).astype(_NATIVE_DOUBLE)
            except ValueError:
                raise self._too_short(data) from None
            cells.setflags(False)  # type: ignore[call-arg]  # write; by keyword it takes longer
            state._values = cells
            return state

        return decode

    def decode_all(self, packets: Sequence[bytes], stamp: Stamp | None = None) -> list[Any]:
        """The states of many packets of the same length, swapped at once: for a reader that fell behind.

        Only for layouts `of_cells`. The states share one array, which lives as long as one of them.
        """
        start, size = int(self.header.sizeof()), len(packets[0])
        count = (self.size - start) // 8
        record = np.dtype({"names": ["cells"], "formats": [(">f8", count)], "offsets": [start], "itemsize": size})
        table = np.frombuffer(b"".join(packets), record)["cells"].astype(_NATIVE_DOUBLE)
        table.setflags(write=False)
        packet, new = self.packet, object.__new__
        states = []
        for data, cells in zip(packets, table, strict=True):
            state = new(packet)
            state._data = data
            state._layout = self
            state._stamp = stamp
            state._values = cells
            states.append(state)
        return states

    def _struct_decoder(self) -> Callable[..., Any]:
        """Mixed widths: one precompiled struct for the whole packet."""
        packet = self.packet
        assert self._struct is not None
        unpack = self._struct.unpack_from
        new = object.__new__

        def decode(data: bytes, stamp: Stamp | None = None) -> Any:
            state = new(packet)
            state._data = data
            state._layout = self
            state._stamp = stamp
            try:
                state._values = unpack(data)
            except struct.error:
                raise self._too_short(data) from None
            return state

        return decode

    def _text_decoder(self) -> Callable[..., Any]:
        """Text in it: walk the fields."""
        packet = self.packet

        def decode(data: bytes, stamp: Stamp | None = None) -> Any:
            values = tuple(value for _, _, _, raws in self._walk(data) for value in raws)
            state = object.__new__(packet)
            state._data = data
            state._layout = self
            state._stamp = stamp
            state._values = values
            return state

        return decode

    def _walk(self, data: bytes) -> Iterator[tuple[Place, int, int, list[Any]]]:
        """Each place with the start and end of its bytes and the raw values in them."""
        offset = int(self.header.sizeof())
        if len(data) < self.size:
            raise self._too_short(data)
        for place in self.places.values():
            start = offset
            if place.code is not None:
                count = place.count or 1
                offset += place.width * count
                self._fits(place, start, offset, data)
                yield place, start, offset, list(struct.unpack_from(f">{count}{place.code}", data, start))
                continue
            shape = place.element
            assert isinstance(shape, Raw)
            if shape.prefix is None:
                text, offset = start, len(data)
            else:
                text = start + int(shape.prefix.sizeof())
                self._fits(place, start, text, data)
                offset = text + int(shape.prefix.parse(data[start:text]))
                self._fits(place, start, offset, data)
            if offset - text < shape.least:
                raise PacketError(
                    f"{place.wire.name} is too short",
                    packet=self.packet.__name__,
                    expected=shape.least,
                    actual=offset - text,
                    offset=text,
                )
            yield place, start, offset, [data[text:offset]]

    def _fits(self, place: Place, start: int, end: int, data: bytes) -> None:
        if end > len(data):
            raise PacketError(
                f"{place.wire.name} runs past the end of the packet",
                packet=self.packet.__name__,
                expected=end,
                actual=len(data),
                offset=start,
            )

    def end(self, data: bytes) -> int:
        """Where the known fields of `data` end; what follows is the unknown tail."""
        if not self.has_text:
            return self.size
        ends = [end for _, _, end, _ in self._walk(data)]
        return ends[-1]

    # -- to the wire ---------------------------------------------------------------------------

    def encode(self, values: Mapping[str, Any], tail: bytes = b"") -> bytes:
        """The packet that holds `values`, header included; what is not given is zero.

        Fields of the class that this layout does not send are passed over, so one mapping serves
        every version.

        Raises:
            BadValue: a name that the class does not have, a wrong number of elements, or a number
                that does not fit its shape.
        """
        if not values.keys() <= self.packet.FIELDS.keys():
            unknown = ", ".join(sorted(values.keys() - self.packet.FIELDS.keys()))
            raise BadValue(f"{self.packet.__name__} has no field {unknown}")
        body = self._encode_cells(values) if self.of_cells else self._encode_runs(values)
        size = int(self.header.sizeof()) + len(body) + len(tail)
        head = {"size": size, **self.constants}
        return bytes(self.header.build(head)) + body + tail

    def _encode_cells(self, values: Mapping[str, Any]) -> bytes:
        cells = np.zeros((self.size - int(self.header.sizeof())) // 8)
        for name, value in values.items():
            place = self.places.get(name)
            if place is None:
                continue
            try:
                if place.code == "Q":
                    mask = place.raw(value)[0]
                    if not 0 <= mask < 1 << 64:
                        raise OverflowError("a mask has 64 bits")
                    cells.view(np.uint64)[place.at] = mask
                elif place.count is None:
                    cells[place.at] = place.raw(value)[0]
                else:
                    vector = np.asarray(value, np.float64)
                    if vector.shape != (place.count,):
                        raise BadValue(f"{name}: expected {place.count} elements, got {value!r}")
                    cells[place.at] = vector
            except BadValue:
                raise
            except (TypeError, ValueError, OverflowError) as error:
                raise BadValue(f"{name}: {value!r} cannot be sent ({error})") from None
        return bytes(cells.astype(_WIRE_DOUBLE).tobytes())

    def _encode_runs(self, values: Mapping[str, Any]) -> bytes:
        body = bytearray()
        for run in self._runs:
            columns = []
            for place in run:
                name = place.wire.name
                columns.append(place.raw(values.get(name, self.constants.get(name, place.default))))
            for row in zip(*columns, strict=True):
                for place, raw in zip(run, row, strict=True):
                    body += self._packed(place, raw)
        return bytes(body)

    def _packed(self, place: Place, raw: Any) -> bytes:
        try:
            if place.code is not None:
                return struct.pack(f">{place.code}", raw)
            prefix = place.element.prefix  # type: ignore[union-attr]
            return bytes(raw if prefix is None else prefix.build(len(raw)) + raw)
        except (struct.error, construct.ConstructError, OverflowError) as error:
            raise BadValue(f"{self.packet.__name__}.{place.wire.name}: {raw!r} cannot be sent ({error})") from None

    # -- other views of the same declaration ---------------------------------------------------

    @cached_property
    def construct(self) -> Any:
        """The layout as one construct `Struct`: the slow oracle. Attribute `tail` is the rest."""
        parts = ["header" / self.header]
        for run in self._runs:
            if run[0].wire.interleave is None:
                parts.append(run[0].wire.name / run[0].shape)
            else:
                element = construct.Struct(*(place.wire.name / place.shape.subcon for place in run))
                parts.append(run[0].wire.interleave / construct.Array(run[0].count, element))
        return construct.Struct(*parts, "tail" / construct.GreedyBytes)

    def parse_slowly(self, data: bytes) -> dict[str, Any]:
        """name -> value of `data`, through construct alone."""
        parsed = self.construct.parse(data)
        values: dict[str, Any] = {}
        for run in self._runs:
            key = run[0].wire.interleave
            for place in run:
                name = place.wire.name
                values[name] = parsed[name] if key is None else [row[name] for row in parsed[key]]
        return values

    @cached_property
    def dtype(self) -> np.dtype[Any]:
        """The numpy dtype of the packet as it lies on the wire, header included.

        Fields that the wire interleaves are strided by numpy's nested dtype under their group's
        name; masks and codes stay numbers.

        Raises:
            BadValue: the packet has text in it, so its size varies.
        """
        if self.has_text:
            raise BadValue(f"{self.packet.__name__} has text in it, so it has no numpy dtype")
        names, offsets = ["message_size"], [0]
        formats: list[np.dtype[Any]] = [np.dtype(">i4")]
        for run in self._runs:
            key = run[0].wire.interleave
            if key is None:
                place = run[0]
                shape = () if place.count is None else (place.count,)
                names.append(place.wire.name)
                formats.append(np.dtype((f">{place.kind}", shape)))
            else:
                element = np.dtype([(place.wire.name, f">{place.kind}") for place in run])
                names.append(key)
                formats.append(np.dtype((element, (run[0].count,))))
            offsets.append(run[0].offset)
        return np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": self.size})

    def dissect(self, data: bytes) -> Iterator[Row]:
        """Every stretch of `data` with its meaning, in wire order, the unknown tail last."""
        yield from header_rows(self.header, data)
        if self.has_text:
            for place, start, end, raws in self._walk(data):
                value = raws if place.count is not None else raws[0]
                if place.element is not None:
                    value = place.element.read(raws[0])
                yield Row(start, data[start:end], place.wire.name, value, place.wire.unit, place.wire.doc)
        else:
            state = self.decode(data)
            for run in self._runs:
                yield from self._dissect_run(run, state)
        if self.end(data) < len(data):
            yield Row(self.end(data), data[self.end(data) :], "tail", None, "", "bytes that no known layout explains")

    def _dissect_run(self, run: list[Place], state: Any) -> Iterator[Row]:
        data = state._data
        if run[0].wire.interleave is None:
            (place,) = run
            value = getattr(state, place.wire.name)
            raw = data[place.offset : place.offset + place.size]
            yield Row(place.offset, raw, place.wire.name, value, place.wire.unit, place.wire.doc)
            return
        for number in range(run[0].count or 0):
            for place in run:
                start = place.offset + number * place.stride
                value = getattr(state, place.wire.name)[number]
                name = f"{place.wire.name}[{number}]"
                yield Row(start, data[start : start + place.width], name, value, place.wire.unit, place.wire.doc)


def _numpy_kind(code: str) -> str:
    return "f" if code in "fd" else "u" if code.isupper() else "i"


def _not_sent(values: Any) -> None:
    return None

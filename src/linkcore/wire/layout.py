"""Layout: one order of fields on the wire, with the offsets, the sizes, the decoder, the encoder and the numpy dtype.

Everything in a `Layout` is derived from the declared fields, so nothing is declared twice. A layout defines the raw
numbers and their offsets; the shapes define the meaning of the numbers. A packet class makes its layouts automatically
(`linkcore.wire.state_layouts`). If the fields are known only at run time, a layout can be made directly::

    layout = Layout("DataPackage", [(field, field.shape) for field in fields], header)
    values = layout.unpack(data)
    values[layout.places["timestamp"].at]

`linkcore.wire.schema` has the same fields as a construct schema.
"""

from __future__ import annotations

import struct
from collections.abc import Collection, Iterator, Mapping, Sequence
from functools import cached_property
from itertools import groupby
from typing import Any

import numpy as np

from ..errors import BadValue, PacketError
from .fields import Field, Header, Mask64, Number, Raw, Shape, Version, version_text

WIRE_DOUBLE = np.dtype(">f8")
NATIVE_DOUBLE = np.dtype("=f8")


class Place:
    """Position of one field in one layout.

    Attributes:
        field: Declaration of the field.
        shape: Shape of the field in this layout.
        number: Type of the number on the wire, or of each number of an array; None for bytes of variable length.
        count: Number of elements of an array; None for a single value.
        offset: Offset of the first byte of the field in the packet. Text fields before this field are counted as empty.
        stride: Number of bytes from one element to the next.
        at: Index, or slice, among the unpacked values of the packet.
    """

    def __init__(self, field: Field, shape: Shape) -> None:
        self.field = field
        self.shape = shape
        self.number = shape.number
        self.count = shape.count
        # The layout sets these attributes, because they depend on the neighbouring fields.
        self.offset = 0
        self.stride = self.width
        self.at: int | slice = 0

    @property
    def width(self) -> int:
        """Size of one element in bytes; 0 if its length varies."""
        return 0 if self.number is None else self.number.width

    @property
    def size(self) -> int:
        """Size of the field in bytes; for text, its minimum size."""
        if isinstance(self.shape, Raw):
            return 0 if self.shape.prefix is None else self.shape.prefix.width
        return self.width * (self.count or 1)

    def raw(self, value: Any) -> list[Any]:
        """Return the numbers or bytes on the wire for `value`, one entry for each element.

        Raises:
            BadValue: If `value` has a wrong number of elements, or an element is not a number.
        """
        name = self.field.name
        if isinstance(value, np.ndarray):
            value = value.tolist()
        if self.count is None:
            elements = [value]
        elif isinstance(value, Sequence) and len(value) == self.count:
            elements = list(value)
        else:
            raise BadValue(f"{name}: expected {self.count} elements, got {value!r}")
        try:
            return [self.shape.write(element) for element in elements]
        except (TypeError, ValueError, OverflowError) as error:
            raise BadValue(f"{name}: {value!r} cannot be sent ({error})") from None


class Layout:
    """One order of fields on the wire.

    Args:
        name: Name of the packet, used in errors.
        fields: Fields in wire order, each with its shape in this layout.
        header: Header before the fields.
        constants: Values of the parts of the header, and default values of fields for the encoder.
        names: Names of the fields that the packet has in any layout; by default the fields of this layout.
        first: First version that has this layout.
        has_block: Whether the layout has the optional fields.

    Attributes:
        places: Name -> `Place`, in wire order.
        fields: Name and shape of each field, in wire order. Two layouts with equal `fields` are the same.
        size: Size of the packet in bytes, header included; with text, its minimum size.
        has_text: Whether the size varies.
        struct: Struct that unpacks the whole packet without its header; None if there is text.
    """

    def __init__(
        self,
        name: str,
        fields: Sequence[tuple[Field, Shape]],
        header: Header,
        *,
        constants: Mapping[str, int] | None = None,
        names: Sequence[str] | None = None,
        first: Version = (0, 0),
        has_block: bool = False,
    ) -> None:
        self.name = name
        self.header = header
        self.constants = dict(constants or {})
        self.first = first
        self.has_block = has_block
        self.places = {field.name: Place(field, shape) for field, shape in fields}
        self.names = tuple(self.places) if names is None else names
        self.fields = tuple((field.name, shape) for field, shape in fields)
        self._arrange()
        self._count = sum(place.count or 1 for place in self.places.values())
        self.struct = None if self.has_text else struct.Struct(self._codes)

    def _arrange(self) -> None:
        """Set the offset of every place, and its index among the unpacked values."""
        offset = self.header.width
        #: Each run has the neighbours of one interleaved group, or a single place.
        self.runs = [
            run
            for key, members in groupby(self.places.values(), key=lambda place: place.field.interleave)
            for run in ([[place] for place in members] if key is None else [list(members)])
        ]
        codes = [f">{offset}x"]
        for run in self.runs:
            count = run[0].count or 1
            stride = sum(place.width for place in run)
            for place in run:
                place.offset, place.stride = offset, stride
                offset += place.size if len(run) == 1 else place.width
            if len(run) > 1:
                offset += stride * (count - 1)
            code = "".join(place.number.code for place in run if place.number is not None)
            codes.append(f"{count}{code}" if len(run) == 1 else code * count)
        for name, at in _indices([(place.field, place.shape) for place in self.places.values()]).items():
            self.places[name].at = at
        self.size = offset
        self.has_text = any(place.number is None for place in self.places.values())
        self._codes = "".join(codes)

    def __repr__(self) -> str:
        version = version_text(self.first)
        return f"<Layout {self.name} since {version}, {self.size}{'+' if self.has_text else ''} bytes>"

    # -- from the wire -------------------------------------------------------------------------

    def too_short(self, data: bytes) -> PacketError:
        """Return the error for `data` that cannot hold the fields."""
        return PacketError(
            "the packet is too short",
            packet=self.name,
            version=version_text(self.first),
            expected=self.size,
            actual=len(data),
            offset=len(data),
        )

    def unpack(self, data: bytes) -> tuple[Any, ...]:
        """Return the numbers and bytes of one complete packet, whose header is skipped.

        Raises:
            PacketError: If the packet is too short.
        """
        if self.struct is None:
            return tuple(value for _, _, _, values in self.stretches(data) for value in values)
        try:
            return self.struct.unpack_from(data)
        except struct.error:
            raise self.too_short(data) from None

    def stretches(self, data: bytes) -> Iterator[tuple[Place, int, int, Sequence[Any]]]:
        """Yield each place, the start and end of its bytes in `data`, and their values.

        Text may have any length. This is only for layouts without interleaved fields.

        Raises:
            PacketError: If a field runs past the end, or has too few bytes.
        """
        offset = self.header.width
        if len(data) < self.size:
            raise self.too_short(data)
        for place in self.places.values():
            start = offset
            if place.number is not None:
                count = place.count or 1
                offset += place.number.width * count
                self._fits(place, start, offset, data)
                yield place, start, offset, struct.unpack_from(f">{count}{place.number.code}", data, start)
                continue
            shape = place.shape
            assert isinstance(shape, Raw)
            if shape.prefix is None:
                text, offset = start, len(data)
            else:
                text = start + shape.prefix.width
                self._fits(place, start, text, data)
                offset = text + int(struct.unpack_from(f">{shape.prefix.code}", data, start)[0])
                self._fits(place, start, offset, data)
            if offset - text < shape.least:
                raise self._error(f"{place.field.name} is too short", shape.least, offset - text, text)
            yield place, start, offset, [data[text:offset]]

    def _fits(self, place: Place, start: int, end: int, data: bytes) -> None:
        if end > len(data):
            raise self._error(f"{place.field.name} runs past the end of the packet", end, len(data), start)

    def _error(self, reason: str, expected: int, actual: int, offset: int) -> PacketError:
        return PacketError(reason, packet=self.name, expected=expected, actual=actual, offset=offset)

    def end(self, data: bytes) -> int:
        """Return the end of the known fields in `data`, where the unknown tail begins."""
        if not self.has_text:
            return self.size
        ends = [end for _, _, end, _ in self.stretches(data)]
        return ends[-1]

    # -- to the wire ---------------------------------------------------------------------------

    def encode(self, values: Mapping[str, Any], tail: bytes = b"") -> bytes:
        """Return the packet with these values, header included; missing values are zero.

        Fields of the packet that this layout does not send are ignored, so the same mapping can be used for every
        version.

        Raises:
            BadValue: If the packet has no such field, a value has a wrong number of elements, or a number does not fit
                its shape.
        """
        if not values.keys() <= set(self.names):
            unknown = ", ".join(sorted(values.keys() - set(self.names)))
            raise BadValue(f"{self.name} has no field {unknown}")
        body = self._encode_at_once(values) or self._encode_runs(values)
        return self.header.pack(**{**self.constants, "size": self.header.width + len(body) + len(tail)}) + body + tail

    def check_complete(self, names: Collection[str]) -> None:
        """Check that no field of this layout would be zero only because its name is missing.

        Raises:
            BadValue: If a field is neither in `names` nor a constant of the layout.
        """
        missing = [name for name in self.places if name not in names and name not in self.constants]
        if missing:
            raise BadValue(f"{self.name}: no value for {', '.join(missing)}")

    def _encode_at_once(self, values: Mapping[str, Any]) -> bytes | None:
        """Encode all fields with one precompiled struct.

        Return None if there is text, or a value does not fit. `_encode_runs` then finds the value that does not fit.
        """
        if self.struct is None:
            return None
        row: list[Any] = [0] * self._count
        for name, place in self.places.items():
            value = values.get(name, self.constants.get(name))
            if value is None:
                if name in values:
                    return None
                continue
            if isinstance(value, np.ndarray):
                value = value.tolist()
            is_list = isinstance(value, (list, tuple))
            is_shaped = not is_list if place.count is None else is_list and len(value) == place.count
            if place.shape.read is None and is_shaped:
                row[place.at] = value  # the struct raises if these are not numbers
            else:
                raw = place.raw(value)
                row[place.at] = raw[0] if place.count is None else raw
        try:
            return self.struct.pack(*row)[self.header.width :]
        except (struct.error, TypeError, OverflowError):
            return None

    def _encode_runs(self, values: Mapping[str, Any]) -> bytes:
        body = bytearray()
        for run in self.runs:
            columns = []
            for place in run:
                name = place.field.name
                given = values.get(name, self.constants.get(name))
                columns.append(_zeros(place) if given is None and name not in values else place.raw(given))
            for row in zip(*columns, strict=True):
                for place, raw in zip(run, row, strict=True):
                    body += self._packed(place, raw)
        return bytes(body)

    def _packed(self, place: Place, raw: Any) -> bytes:
        try:
            if place.number is not None:
                return struct.pack(f">{place.number.code}", raw)
            prefix = place.shape.prefix  # type: ignore[attr-defined]  # only `Raw` has no number
            return bytes(raw if prefix is None else struct.pack(f">{prefix.code}", len(raw)) + raw)
        except (struct.error, OverflowError) as error:
            raise BadValue(f"{self.name}.{place.field.name}: {raw!r} cannot be sent ({error})") from None

    # -- many packets at once ------------------------------------------------------------------

    @property
    def of_cells(self) -> bool:
        """Whether all fields are 8-byte cells, so that the bytes of many packets can be swapped together.

        A 64-bit integer is not such a cell, because it would lose its value if it were read as a double. A mask is such
        a cell, because its bits are read.
        """
        shapes = [shape for _, shape in self.fields]
        return all(shape is Mask64 or (shape.number is not None and shape.number.code == "d") for shape in shapes)

    @cached_property
    def dtype(self) -> np.dtype[Any]:
        """Numpy dtype of the packet on the wire, including the header.

        Interleaved fields are in a nested dtype under the name of their group. Masks and codes stay numbers. Of the
        header, only the size field is included, as `message_size`.

        Raises:
            BadValue: If the packet contains text, so that its size varies.
        """
        if self.has_text:
            raise BadValue(f"{self.name} contains text of variable length, so it has no numpy dtype")
        names, offsets = ["message_size"], [0]
        formats: list[Any] = [_wire_dtype(self.header.parts["size"])]
        for run in self.runs:
            key = run[0].field.interleave
            if key is None:
                place = run[0]
                names.append(place.field.name)
                formats.append(np.dtype((_wire_dtype(place.number), () if place.count is None else (place.count,))))
            else:
                element = np.dtype([(place.field.name, _wire_dtype(place.number)) for place in run])
                names.append(key)
                formats.append(np.dtype((element, (run[0].count,))))
            offsets.append(run[0].offset)
        return np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": self.size})


def _indices(fields: Sequence[tuple[Field, Shape]]) -> dict[str, int | slice]:
    """Return the index of each field among the unpacked values of a packet; for an array, a slice."""
    found: dict[str, int | slice] = {}
    index = 0
    for key, members in groupby(fields, key=lambda member: member[0].interleave):
        group = list(members)
        step = 1 if key is None else len(group)
        for number, (field, shape) in enumerate(group):
            count = shape.count or 1
            begin = index if key is None else index + number
            found[field.name] = begin if shape.count is None else slice(begin, begin + step * (count - 1) + 1, step)
            index += count if key is None else 0
        if key is not None:
            # All fields of a group have the same length, and are sent element by element in turn.
            index += step * (group[0][1].count or 1)
    return found


def _zeros(place: Place) -> list[Any]:
    """Return the values on the wire for a field without a given value."""
    return [b"" if place.number is None else 0] * (place.count or 1)


def _wire_dtype(number: Number | None) -> np.dtype[Any]:
    assert number is not None, "text has no dtype"
    return np.dtype(f">{number.kind}")

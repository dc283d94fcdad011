"""Parts of a packet declaration: header, fields, versions that send each field, and shapes of the values.

There are several generations of a peer, which are maintained in parallel. For example, a field exists since 3.10, and
in the next generation since 5.4. This is written as ``"3.10/5.4"``.

A shape is the coding of one field: numbers, coded numbers, a mask with two codings, text or raw bytes. It defines the
number or the bytes on the wire, and the conversion to and from the value that users get. The fast decoder is derived
from the shape. The numbers have the names of construct, and `linkcore.wire.schema` builds the same packets from
construct's numbers. A property test checks that both are equal.
"""

from __future__ import annotations

import enum
import struct
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any, NamedTuple

from ..errors import BadVersion

#: Code of a coded float that is not a whole number.
NOT_A_CODE = -(2**31)

# Maximum number of cached meanings for each shape. The numbers come from the wire, so their number is not limited.
_MOST_CODES = 256


class OpenInt(enum.IntEnum):
    """An IntEnum that accepts numbers without a name, because the next release might send one.

    >>> class Mode(OpenInt):
    ...     IDLE = 5
    >>> Mode(5).name, Mode(77).name, Mode(77) == 77
    ('IDLE', 'UNKNOWN_77', True)
    """

    @classmethod
    def _missing_(cls, value: object) -> OpenInt:
        if not isinstance(value, int):
            raise ValueError(f"{value!r} is not a whole number")
        unknown = int.__new__(cls, value)
        unknown._name_ = f"UNKNOWN_{value}"
        unknown._value_ = value
        return unknown


class Shape:
    """Shape of one field on the wire. ``shape[6]`` is an array of six.

    Attributes:
        number: Type of the number on the wire, or of each number of an array; None for bytes of variable length.
        count: Number of elements of an array; None for a single value.
        read: Function that converts a number, or the bytes, to the value that users get. It never fails. None if this
            value is the number itself.
    """

    number: Number | None
    count: int | None = None
    read: Callable[[Any], Any] | None = None

    def write(self, value: Any) -> Any:
        """Convert a value to the wire, as the inverse of `read`.

        Raises:
            TypeError, ValueError, OverflowError: If the shape has no such value.
        """
        raise NotImplementedError

    def __getitem__(self, count: int) -> Array:
        return Array(self, count)


class Number(Shape):
    """Number in network byte order.

    Attributes:
        name: Name in construct.
        code: Letter in `struct`.
        width: Number of bytes.
        kind: Name in numpy, such as "f8". The letters of `struct` differ: numpy's "L" has 8 bytes on Linux.
    """

    def __init__(self, name: str, code: str) -> None:
        self.number = self
        self.name = name
        self.code = code
        self.width = struct.calcsize(f">{code}")
        self.kind = f"{'f' if code in 'fd' else 'u' if code.isupper() else 'i'}{self.width}"

    def __repr__(self) -> str:
        return self.name

    def write(self, value: Any) -> Any:
        return value + 0  # raises for a value that is not a number


Float32b, Float64b = Number("Float32b", "f"), Number("Float64b", "d")
Int8sb, Int8ub = Number("Int8sb", "b"), Number("Int8ub", "B")
Int16sb, Int16ub = Number("Int16sb", "h"), Number("Int16ub", "H")
Int32sb, Int32ub = Number("Int32sb", "i"), Number("Int32ub", "I")
Int64sb, Int64ub = Number("Int64sb", "q"), Number("Int64ub", "Q")


class Array(Shape):
    """Array of a declared number of elements of one shape, one after the other."""

    def __init__(self, element: Shape, count: int) -> None:
        self.element = element
        self.number = element.number
        self.count = count
        self.read = element.read

    def __repr__(self) -> str:
        return f"{self.element!r}[{self.count}]"

    def write(self, value: Any) -> Any:
        return self.element.write(value)


class _Meanings(dict[float, Any]):
    """Number -> its meaning, made when it is looked up for the first time."""

    def __init__(self, meaning: Callable[[int], Any]) -> None:
        self._meaning = meaning

    def __missing__(self, raw: float) -> Any:
        # NaN and infinity are out of the range, and fractions fail the comparison.
        is_whole = isinstance(raw, int) or (-(2**31) < raw < 2**31 and raw == int(raw))
        meaning = self._meaning(int(raw) if is_whole else NOT_A_CODE)
        if len(self) < _MOST_CODES:
            self[raw] = meaning
        return meaning


class Coded(Shape):
    """Number that is a code for another value, such as `Coded(Int8ub, JointMode)` or `Coded(Int8ub, bool)`.

    In a float shape, the code is a whole number in a float. Any other float has the code `NOT_A_CODE`.
    """

    def __init__(self, number: Number, meaning: Callable[[int], Any]) -> None:
        self.number = number
        self.meaning = meaning
        # 5 and 5.0 are the same key. The bound method of a dict is the fastest kind of function.
        self.read = _Meanings(meaning).__getitem__
        self._write: Callable[[Any], Any] = float if number.code in "fd" else int

    def __repr__(self) -> str:
        return f"Coded({self.number!r}, {getattr(self.meaning, '__name__', self.meaning)})"

    def write(self, value: Any) -> Any:
        return self._write(value)


class _Mask64(Shape):
    """Bit mask in 64 bits, which is coded either as an integer or as an IEEE double with the same value.

    Public decoders of the UR real-time interface disagree on the coding, and no captured bytes of a robot decide it
    (docs/protocols/realtime.md, section Digital inputs and outputs). The two codings cannot be confused. As an integer,
    a mask of up to 48 bits has zeros in its top 16 bits; a double of 1.0 or more does not. If the bits match neither
    coding, the value is the raw 64 bits.
    """

    number = Int64ub

    def __repr__(self) -> str:
        return "Mask64"

    @staticmethod
    def read(raw: int) -> int:
        if raw >> 48:
            (value,) = struct.unpack("=d", struct.pack("=Q", raw))
            if 0.0 <= value < 2.0**48 and value == int(value):
                return int(value)
        return raw

    def write(self, value: Any) -> int:
        mask = int(value)
        if not 0 <= mask < 1 << 64:
            raise OverflowError("a mask must fit into 64 bits")
        return mask


Mask64 = _Mask64()


class Raw(Shape):
    """Raw bytes: all bytes up to the end of the packet, or as many bytes as the number `prefix` states.

    `least` is the minimum number of bytes of the field. A layout that leaves fewer bytes for the field does not fit.
    """

    number = None

    def __init__(self, prefix: Number | None = None, least: int = 0) -> None:
        self.prefix = prefix
        self.least = least

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.prefix or ''})"

    def write(self, value: Any) -> bytes:
        return bytes(value)


class Text(Raw):
    """UTF-8 text.

    Bytes that are not UTF-8 become backslash escapes, so that reading never fails.
    """

    @staticmethod
    def read(raw: bytes) -> str:
        return raw.decode("utf-8", "backslashreplace")

    def write(self, value: Any) -> bytes:
        return str(value).encode("utf-8", "backslashreplace")


#: ``(major, minor, ...)``. Any NamedTuple of integers can be used, because versions are compared as tuples.
Version = tuple[int, ...]


def parse_version(text: str | Version) -> Version:
    """Convert ``"3.10"`` to ``(3, 10)``; a tuple is returned unchanged.

    Raises:
        BadVersion: If the text is not two or more whole numbers separated by dots.

    >>> parse_version("5.11.1")
    (5, 11, 1)
    """
    if not isinstance(text, str):
        return text
    parts = text.strip().split(".")
    if len(parts) < 2 or not all(part.isascii() and part.isdigit() and len(part) < 7 for part in parts):
        raise BadVersion(f"{text!r} is not a version; expected something like '5.11'")
    return tuple(int(part) for part in parts)


def version_text(version: Version) -> str:
    """Convert ``(3, 10)`` to ``"3.10"``; a version of another type has its own text."""
    return ".".join(map(str, version)) if type(version) is tuple else str(version)


class Since:
    """First version of each generation that has a feature, as in ``Since("3.10/5.4")``.

    A version is compared with the entry of the same generation, or else with the entry of the nearest earlier
    generation. So if a later generation has an entry, its versions before that entry do not have the feature.

    >>> since = Since("3.10/5.4")
    >>> [version in since for version in [(1, 8), (3, 9), (3, 10), (5, 0), (5, 4), (10, 7)]]
    [False, False, True, False, True, True]
    """

    def __init__(self, text: str) -> None:
        self.text = text
        self.firsts = tuple(sorted(parse_version(part) for part in text.split("/")))

    def __contains__(self, version: Version) -> bool:
        entry = [first for first in self.firsts if first[0] <= version[0]]
        return bool(entry) and version >= entry[-1]

    def __repr__(self) -> str:
        return f"Since({self.text!r})"

    @property
    def steps(self) -> set[Version]:
        """Versions at which the result can change."""
        return {*self.firsts, *((first[0], 0) for first in self.firsts[1:])}


class Header:
    """Numbers before the fields of a packet; the first number is `size`, the size of the whole packet in bytes.

    ``Header(size=Int32sb, type=Int8ub)``

    Attributes:
        parts: Name -> number, in wire order.
        width: Size of the header, in bytes.
    """

    def __init__(self, **parts: Number) -> None:
        self.parts: Mapping[str, Number] = MappingProxyType(parts)
        self._struct = struct.Struct(">" + "".join(number.code for number in parts.values()))
        self.width = self._struct.size

    def pack(self, **values: int) -> bytes:
        """Return the header on the wire. A missing part is zero, and other names are ignored."""
        return self._struct.pack(*(values.get(name, 0) for name in self.parts))

    def unpack(self, data: bytes) -> dict[str, int]:
        """Return name -> value for the parts of the header at the beginning of `data`."""
        return dict(zip(self.parts, self._struct.unpack_from(data), strict=True))


class Field(NamedTuple):
    """Declaration of one field; `linkcore.wire.packet.wire` describes each entry."""

    name: str
    shape: Shape
    unit: str = ""
    doc: str = ""
    since: Since = Since("0.0")
    until: Version | None = None
    before: tuple[Version, Shape] | None = None
    interleave: str | None = None
    block: str | None = None

    def shape_in(self, version: Version) -> Shape | None:
        """Return the shape that `version` sends; None if it does not send the field."""
        if version not in self.since or (self.until is not None and version >= self.until):
            return None
        if self.before is not None and version < self.before[0]:
            return self.before[1]
        return self.shape

    @property
    def steps(self) -> set[Version]:
        """Versions at which the result of `shape_in` can change."""
        others = [self.until, None if self.before is None else self.before[0]]
        return self.since.steps | {version for version in others if version is not None}

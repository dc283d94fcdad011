"""The parts of which a packet is declared: header, fields, the versions that send each, and the shape of its values.

A peer is made in several generations that are maintained side by side, so "since 3.10 and, in the next generation,
since 5.4" is one fact; it is written ``"3.10/5.4"``.

A shape is how one field is coded: numbers, coded numbers, a mask of two codings, text, raw bytes. It
says which number, or which bytes, lie on the wire, and how they are converted to the value that users hold, and
back. The fast decoder is derived from that. The numbers have construct's names, and `linkcore.wire.schema` builds
the same from construct's own numbers; a property test holds the two equal.
"""

from __future__ import annotations

import enum
import struct
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any, NamedTuple

from ..errors import BadVersion

#: What a coded float reads as when it holds no whole number.
NOT_A_CODE = -(2**31)

# Numbers whose meaning is remembered, for each shape. They come off the wire, so there may be any number of them.
_MOST_CODES = 256


class OpenInt(enum.IntEnum):
    """An IntEnum that takes numbers without a name, since the next release may send one.

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
    """One field on the wire. ``shape[6]`` is six of it.

    Attributes:
        number: the number on the wire, or each of several; None for bytes, of which there may be any number.
        count: how many, as an array; None for a single one.
        read: from one number, or the bytes, to what the user holds; None where that is the number itself. Never fails.
    """

    number: Number | None
    count: int | None = None
    read: Callable[[Any], Any] | None = None

    def write(self, value: Any) -> Any:
        """The inverse of `read`.

        Raises:
            TypeError, ValueError, OverflowError: it has no such value.
        """
        raise NotImplementedError

    def __getitem__(self, count: int) -> Array:
        return Array(self, count)


class Number(Shape):
    """A number in network byte order.

    Attributes:
        name: construct's.
        code: struct's letter.
        width: bytes.
        kind: numpy's name of it, such as "f8". struct's letters will not do: numpy's "L" has 8 bytes on Linux.
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
        return value + 0  # what is not a number cannot be added to one


Float32b, Float64b = Number("Float32b", "f"), Number("Float64b", "d")
Int8sb, Int8ub = Number("Int8sb", "b"), Number("Int8ub", "B")
Int16sb, Int16ub = Number("Int16sb", "h"), Number("Int16ub", "H")
Int32sb, Int32ub = Number("Int32sb", "i"), Number("Int32ub", "I")
Int64sb, Int64ub = Number("Int64sb", "q"), Number("Int64ub", "Q")


class Array(Shape):
    """As many of one shape as declared, one after the other."""

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
    """number -> its meaning, made when it is looked up for the first time."""

    def __init__(self, meaning: Callable[[int], Any]) -> None:
        self._meaning = meaning

    def __missing__(self, raw: float) -> Any:
        # NaN and the infinities fail the range, fractions the comparison.
        is_whole = isinstance(raw, int) or (-(2**31) < raw < 2**31 and raw == int(raw))
        meaning = self._meaning(int(raw) if is_whole else NOT_A_CODE)
        if len(self) < _MOST_CODES:
            self[raw] = meaning
        return meaning


class Coded(Shape):
    """A number that stands for something: `Coded(Int8ub, JointMode)`, `Coded(Int8ub, bool)`.

    In a float shape the number is a whole one held in a float; any other float reads as the code `NOT_A_CODE`.
    """

    def __init__(self, number: Number, meaning: Callable[[int], Any]) -> None:
        self.number = number
        self.meaning = meaning
        # 5 and 5.0 are the same key. The bound method of a dict is the quickest function there is.
        self.read = _Meanings(meaning).__getitem__
        self._write: Callable[[Any], Any] = float if number.code in "fd" else int

    def __repr__(self) -> str:
        return f"Coded({self.number!r}, {getattr(self.meaning, '__name__', self.meaning)})"

    def write(self, value: Any) -> Any:
        return self._write(value)


class _Mask64(Shape):
    """64 bits that hold a mask either as an integer or as an IEEE double of the same value.

    Public decoders of the UR real-time interface disagree on the coding, and no robot bytes decide it
    (docs/protocols/realtime.md, section Digital inputs and outputs). The two cannot be confused: a mask of up to 48
    bits has its top 16 bits clear as an integer, and a double of 1.0 or more has not. What is neither reads as the raw
    64 bits.
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
            raise OverflowError("a mask has 64 bits")
        return mask


Mask64 = _Mask64()


class Raw(Shape):
    """Bytes up to the end of the packet, or as many as `prefix` counts.

    `least` is the number of bytes below which the field cannot be what it should be: a layout that leaves less for it
    does not fit.
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
    """UTF-8 text. Bytes that are not UTF-8 read as backslash escapes, so that text never fails."""

    @staticmethod
    def read(raw: bytes) -> str:
        return raw.decode("utf-8", "backslashreplace")

    def write(self, value: Any) -> bytes:
        return str(value).encode("utf-8", "backslashreplace")


#: ``(major, minor, ...)``; longer tuples compare as tuples do, so any NamedTuple of integers will do.
Version = tuple[int, ...]


def parse_version(text: str | Version) -> Version:
    """``"3.10"`` -> ``(3, 10)``; a tuple is returned as it is.

    Raises:
        BadVersion: the text is not two or more dot-separated whole numbers.

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
    """``(3, 10)`` -> ``"3.10"``; versions that are more than a tuple say it themselves."""
    return ".".join(map(str, version)) if type(version) is tuple else str(version)


class Since:
    """The first version of each generation that has something, as in ``Since("3.10/5.4")``.

    A version is judged by the entry of the nearest generation at or below its own, so what one
    generation gained late is absent from the next one until that generation's own entry.

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
        """The versions at which the answer can change."""
        return {*self.firsts, *((first[0], 0) for first in self.firsts[1:])}


class Header:
    """Numbers that precede the fields of a packet; the first of them is `size`, the bytes of the whole packet.

    ``Header(size=Int32sb, type=Int8ub)``

    Attributes:
        parts: name -> number, in wire order.
        width: bytes of the header.
    """

    def __init__(self, **parts: Number) -> None:
        self.parts: Mapping[str, Number] = MappingProxyType(parts)
        self._struct = struct.Struct(">" + "".join(number.code for number in parts.values()))
        self.width = self._struct.size

    def pack(self, **values: int) -> bytes:
        """The header on the wire; a part that is not given is zero, and what is not a part of it is passed over."""
        return self._struct.pack(*(values.get(name, 0) for name in self.parts))

    def unpack(self, data: bytes) -> dict[str, int]:
        """name -> value of the parts of the header that `data` begins with."""
        return dict(zip(self.parts, self._struct.unpack_from(data), strict=True))


class Field(NamedTuple):
    """The declaration of one field; `linkcore.wire.packet.wire` describes each entry."""

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
        """The shape that `version` sends, or None where it does not send the field."""
        if version not in self.since or (self.until is not None and version >= self.until):
            return None
        if self.before is not None and version < self.before[0]:
            return self.before[1]
        return self.shape

    @property
    def steps(self) -> set[Version]:
        """The versions at which the answer of `shape_in` can change."""
        others = [self.until, None if self.before is None else self.before[0]]
        return self.since.steps | {version for version in others if version is not None}

"""Wire shapes beyond construct's own: coded numbers, 64-bit masks of two codings, text, raw bytes.

A shape is a construct, so construct alone can parse a schema. Each shape here also offers `read`
and `write`, the conversion between what lies on the wire and what the user holds; the fast decoder
is derived from them.
"""

from __future__ import annotations

import enum
import struct
from collections.abc import Callable
from typing import Any

import construct

__all__ = ["NOT_A_CODE", "Coded", "Mask64", "OpenInt", "Raw", "Shape", "Text"]

#: What a coded float reads as when it holds no whole number.
NOT_A_CODE = -(2**31)


class OpenInt(enum.IntEnum):
    """An IntEnum that takes numbers it has no name for, since the next release will send one.

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


class Shape(construct.Adapter):  # type: ignore[misc]
    """A construct that converts: `read` from the wire, `write` to it."""

    def read(self, raw: Any) -> Any:
        """What the user holds, of what construct's own shape parsed. Never fails."""
        raise NotImplementedError

    def write(self, value: Any) -> Any:
        """The inverse of `read`."""
        raise NotImplementedError

    def _decode(self, obj: Any, context: Any, path: Any) -> Any:
        return self.read(obj)

    def _encode(self, obj: Any, context: Any, path: Any) -> Any:
        return self.write(obj)


class Coded(Shape):
    """A number that stands for something: `Coded(Int8ub, JointMode)`, `Coded(Int8ub, bool)`.

    On a float shape the number is a whole one held in a float; any other float reads as the code
    `NOT_A_CODE`.
    """

    def __init__(self, subcon: Any, meaning: Callable[[int], Any]) -> None:
        super().__init__(subcon)
        self.meaning = meaning
        self.in_float = subcon.fmtstr[-1] in "fd"

    def read(self, raw: float) -> Any:
        if not self.in_float:
            return self.meaning(raw)  # type: ignore[arg-type]
        # NaN and the infinities fail the range, fractions the comparison.
        whole = -(2**31) < raw < 2**31 and raw == int(raw)
        return self.meaning(int(raw) if whole else NOT_A_CODE)

    def write(self, value: Any) -> float:
        return float(value) if self.in_float else int(value)


class _Mask64(Shape):
    """64 bits that hold a mask either as an integer or as an IEEE double of the same value.

    Public decoders of the UR real-time interface disagree on the coding, and no robot bytes decide
    it. The two cannot be confused: a mask of up to 48 bits has its top 16 bits clear as an integer,
    and a double of 1.0 or more has not. What is neither reads as the raw 64 bits.
    """

    def read(self, raw: int) -> int:
        if raw >> 48:
            (value,) = struct.unpack("=d", struct.pack("=Q", raw))
            if 0.0 <= value < 2.0**48 and value == int(value):
                return int(value)
        return raw

    def write(self, value: Any) -> int:
        return int(value)


Mask64 = _Mask64(construct.Int64ub)


class Raw(Shape):
    """Bytes up to the end of the packet, or as many as `prefix` counts.

    `least` is the number of bytes below which the field cannot be what it should be: a layout that
    leaves less for it does not fit.
    """

    def __init__(self, prefix: Any = None, least: int = 0) -> None:
        rest = construct.GreedyBytes
        super().__init__(rest if prefix is None else construct.Prefixed(prefix, rest))
        self.prefix = prefix
        self.least = least

    def read(self, raw: bytes) -> Any:
        return raw

    def write(self, value: Any) -> bytes:
        return bytes(value)


class Text(Raw):
    """UTF-8 text. Bytes that are not UTF-8 read as backslash escapes, so that text never fails."""

    def read(self, raw: bytes) -> str:
        return raw.decode("utf-8", "backslashreplace")

    def write(self, value: Any) -> bytes:
        return str(value).encode("utf-8", "backslashreplace")

"""Value types, which convert between 32-bit words and numbers, text or structures.

Values are packed as in the memory of a C++ program.

The wrappers around the original copy the memory of a value into as many words as the value needs, and each word is sent
separately (docs/protocols/rhd.md, Encoding). So a double consists of two words, in the order of the robot's machine. On
a little-endian machine, the low word is first; every known robot is little-endian. On a big-endian machine, the high
word is first. The ``order`` of a declaration selects the order. A value of one word is the same in both orders.
"""

from __future__ import annotations

import contextlib
import operator
import struct
import sys
from collections.abc import Callable
from typing import Any, Generic, Literal, SupportsFloat, SupportsIndex, TypeVar

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from linkcore.errors import BadValue

from ..wire.data import Words, read_only

#: Byte order of the robot's machine: whether the lowest or the highest byte of a number comes first.
Order = Literal["little", "big"]

#: Function that reads the value of a variable from the memory of a table, at an offset in bytes. The words are in the
#: order of this machine. It returns a tuple with the value as its only item, so `struct.Struct.unpack_from` can be used
#: directly.
Reader = Callable[[bytearray, int], tuple[Any, ...]]
#: Function that makes the words of a value; one word may be an int.
Packer = Callable[[Any], "Words | int"]

V = TypeVar("V")
A = TypeVar("A")
S = TypeVar("S")

_MARK: dict[str, Literal["<", ">"]] = {"little": "<", "big": ">"}
#: Name of a number type in numpy -> format letter of struct.
_LETTERS = {"i4": "i", "u4": "I", "i8": "q", "f4": "f", "f8": "d"}
_WORD_SIZE = 4
#: Reader of one word in the order of this machine.
_read_word = struct.Struct("=i").unpack_from
_read_two_words = struct.Struct("=ii").unpack_from
_ZERO = (0,)
#: Range of one word.
_LEAST, _MOST = -(2**31), 2**31 - 1


def wrapped(count: float, bits: int = 32) -> int:
    """Round a counter and wrap it to `bits` bits, as robots do.

    After 2147483647 comes -2147483648.
    """
    half = 1 << (bits - 1)
    return (round(count) + half) % (2 * half) - half


class ValueType(Generic[V, A, S]):
    """Type of a variable's values.

    `V` is the Python type of one value, `A` is the type of several values, and `S` is the type that can be set.

    Attributes:
        unit: Unit of the values; "" for none.
    """

    unit: str = ""

    def length(self, count: int) -> int:
        """Return the number of 32-bit words that `count` values need."""
        raise NotImplementedError

    def unpack(self, words: Words, order: Order) -> V:
        """Convert the words of a variable to its value. Never fails."""
        values: Any = self.unpack_many(words, 1, order)
        value: V = values[0]
        return value

    def unpack_many(self, words: Words, count: int, order: Order) -> A:
        """Convert the words of a variable to its values, which do not change with it. Never fails."""
        raise NotImplementedError

    def pack(self, value: S, order: Order) -> Words:
        """Convert a value to words. Raises `BadValue`."""
        values: Any = [value]
        return self.pack_many(values, 1, order)

    def pack_many(self, values: ArrayLike, count: int, order: Order) -> Words:
        """Convert `count` values to words. Raises `BadValue`."""
        raise NotImplementedError

    def reader(self, count: int, order: Order) -> Reader:
        """Return a function that reads like `unpack` or `unpack_many`, but is faster for some types."""
        length = self.length(count)

        def read(memory: bytearray, offset: int) -> tuple[Any]:
            words = np.frombuffer(memory, np.int32, length, offset)
            return (self.unpack(words, order) if count == 1 else self.unpack_many(words, count, order),)

        return read

    def packer(self, count: int, order: Order) -> Packer:
        """Return a function that packs like `pack` or `pack_many`, but is faster for some types."""
        if count == 1:
            return lambda value: self.pack(value, order)
        return lambda values: self.pack_many(values, count, order)


def _memory(words: Words, order: Order) -> bytes:
    """Return the bytes of these words in the memory of the robot's machine."""
    return words.tobytes() if order == sys.byteorder else words.byteswap().tobytes()


def _words(memory: bytes, order: Order) -> Words:
    """Return the words for these bytes, as the inverse of `_memory`. Zeros fill the rest of the last word."""
    words = np.frombuffer(memory + bytes(-len(memory) % 4), np.int32)
    return words if order == sys.byteorder else words.byteswap()


def _shaped(values: ArrayLike, count: int, what: str) -> NDArray[Any]:
    try:
        array = np.asarray(values)
    except (ValueError, TypeError, OverflowError) as error:
        raise BadValue(f"{values!r} is not {count} values of {what}: {error}") from None
    if array.shape != (count,):
        raise BadValue(f"{what}: expected {count} values, got an array of shape {array.shape}")
    return array


def _read_bool(memory: bytearray, offset: int) -> tuple[bool]:
    return (_read_word(memory, offset) != _ZERO,)


class _Number(ValueType[V, A, S]):
    """Type for numbers of one machine type."""

    def __init__(self, name: str, type_name: str) -> None:
        self._name = name
        self._letter = _LETTERS[type_name]
        self._structs = {order: struct.Struct(mark + self._letter) for order, mark in _MARK.items()}
        self._types = {order: np.dtype(mark + type_name) for order, mark in _MARK.items()}
        self._native = np.dtype(type_name)

    def __repr__(self) -> str:
        return self._name

    def length(self, count: int) -> int:
        return count * self._native.itemsize // 4

    def unpack(self, words: Words, order: Order) -> V:
        (value,) = self._structs[order].unpack(_memory(words, order))
        result: V = value
        return result

    def unpack_many(self, words: Words, count: int, order: Order) -> A:
        result: Any = read_only(np.frombuffer(_memory(words, order), self._types[order], count).astype(self._native))
        return result  # type: ignore[no-any-return]

    def reader(self, count: int, order: Order) -> Reader:
        is_swapped = self._native.itemsize > _WORD_SIZE and order != sys.byteorder
        if count > 1:
            if is_swapped:
                return super().reader(count, order)
            native = self._native
            return lambda memory, offset: (read_only(np.frombuffer(memory, native, count, offset).copy()),)
        if not is_swapped:
            return struct.Struct("=" + self._letter).unpack_from
        # Each word is in the order of this machine, so arrange the words in the robot's order before they become one
        # value.
        read_words, write_words = struct.Struct("=II").unpack_from, struct.Struct(_MARK[order] + "II").pack
        unpack = self._structs[order].unpack
        return lambda memory, offset: unpack(write_words(*read_words(memory, offset)))

    def pack(self, value: S, order: Order) -> Words:
        return _words(self._structs[order].pack(self._checked(value)), order)

    def pack_many(self, values: ArrayLike, count: int, order: Order) -> Words:
        array = self._checked_many(_shaped(values, count, self._name))
        return _words(array.astype(self._types[order]).tobytes(), order)

    def _checked(self, value: S) -> float:
        """Return the number if this type can hold it. Otherwise raise `BadValue`."""
        raise NotImplementedError

    def _checked_many(self, values: NDArray[Any]) -> NDArray[Any]:
        raise NotImplementedError


class _Integer(_Number[int, A, SupportsIndex]):
    def __init__(self, name: str, type_name: str) -> None:
        super().__init__(name, type_name)
        info = np.iinfo(self._native)
        self._least, self._most = int(info.min), int(info.max)

    def packer(self, count: int, order: Order) -> Packer:
        pack_any = super().packer(count, order)
        if self._least != _LEAST or self._most != _MOST:
            return pack_any
        if count == 1:
            return self._checked
        pack = struct.Struct(f"={count}i").pack

        def pack_list(values: Any) -> Words:
            # struct rejects values that are not 32-bit integers in a tenth of the time. numpy then finds the exact
            # error.
            if type(values) is list:
                with contextlib.suppress(struct.error):
                    return np.frombuffer(pack(*values), np.int32)
            return pack_any(values)  # type: ignore[return-value]

        return pack_list

    def _checked(self, value: SupportsIndex) -> int:
        try:
            number = operator.index(value)
        except TypeError:
            raise BadValue(f"{value!r} is not an integer; expected {self._range}") from None
        if not self._least <= number <= self._most:
            raise BadValue(f"{number} does not fit; expected {self._range}")
        return number

    def _checked_many(self, values: NDArray[Any]) -> NDArray[Any]:
        # Integers beyond 64 bits are objects, so each value is checked individually.
        if values.dtype.kind not in "iub" or (len(values) and not self._holds(values)):
            return np.array([self._checked(each) for each in values.tolist()], self._native)
        return values

    def _holds(self, values: NDArray[Any]) -> bool:
        return self._least <= int(values.min()) and int(values.max()) <= self._most

    @property
    def _range(self) -> str:
        return f"{self._name}, {self._least} to {self._most}"


class _Float(_Number[float, NDArray[Any], SupportsFloat]):
    def __init__(self, name: str, type_name: str) -> None:
        super().__init__(name, type_name)
        self._most = float(np.finfo(self._native).max)

    def _checked(self, value: SupportsFloat) -> float:
        return float(self._checked_many(_numbers([value], 1, self._name))[0])

    def _checked_many(self, values: NDArray[Any]) -> NDArray[Any]:
        numbers = _numbers(values, len(values), self._name)
        large = np.isfinite(numbers) & (np.abs(numbers) > self._most)
        if large.any():
            raise BadValue(f"{numbers[large][0]} does not fit; expected {self._name}, up to {self._most}")
        return numbers


def _numbers(values: Any, count: int, what: str) -> NDArray[np.float64]:
    """Convert values to float64.

    Raises `BadValue` for values that are not numbers, even for numeric text.
    """
    array = _shaped(values, count, what)
    if array.dtype.kind not in "fiubO":
        raise BadValue(f"{values!r} is not {what}: expected numbers")
    try:
        if array.dtype.kind == "O":  # integers beyond 64 bits, or Decimal; numpy would make NaN from None
            return np.array([float(each) for each in array], np.float64)
        return array.astype(np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise BadValue(f"{values!r} is not {what}: {error}") from None


class _Flag(ValueType[bool, NDArray[np.bool_], bool]):
    """Type for a word that is zero or not zero. It is written as 0 or 1."""

    def __repr__(self) -> str:
        return "Bool"

    def length(self, count: int) -> int:
        return count

    def reader(self, count: int, order: Order) -> Reader:
        return super().reader(count, order) if count > 1 else _read_bool

    def unpack(self, words: Words, order: Order) -> bool:
        return bool(words[0])

    def unpack_many(self, words: Words, count: int, order: Order) -> NDArray[np.bool_]:
        return read_only(words != 0)

    def pack_many(self, values: ArrayLike, count: int, order: Order) -> Words:
        array = _shaped(values, count, "Bool")
        if array.dtype.kind not in "b" and not (array.dtype.kind in "iu" and np.isin(array, (0, 1)).all()):
            raise BadValue(f"{values!r} is not a Bool; expected True or False")
        return array.astype(np.int32)


class Scaled(ValueType[float, NDArray[np.float64], SupportsFloat]):
    """Type for fixed-point numbers: a 32-bit integer counts steps of `scale`.

    Written values are rounded to the nearest step, whereas C programs drop the fraction.

    Args:
        scale: Value of one step, in `unit`.
        unit: Unit of the value.

    Raises:
        BadValue: If `scale` is not a positive number.
    """

    def __init__(self, scale: float, *, unit: str = "") -> None:
        if not 0 < scale < float("inf"):
            raise BadValue(f"Scaled({scale}): expected a positive number")
        self.scale = scale
        self.unit = unit

    def __repr__(self) -> str:
        return f"Scaled({self.scale:g}, unit={self.unit!r})" if self.unit else f"Scaled({self.scale:g})"

    def length(self, count: int) -> int:
        return count

    def reader(self, count: int, order: Order) -> Reader:
        if count > 1:
            return super().reader(count, order)
        scale = self.scale
        return lambda memory, offset: (_read_word(memory, offset)[0] * scale,)

    def packer(self, count: int, order: Order) -> Packer:
        pack_any = super().packer(count, order)
        scale = self.scale

        def pack_number(value: Any) -> Words | int:
            # Both ways round halves to even. `pack` raises the error for a value that does not fit or is not a plain
            # number.
            if type(value) is float or type(value) is int:
                steps = value / scale
                if _LEAST <= steps <= _MOST:
                    return round(steps)
            return pack_any(value)

        return pack_number if count == 1 else pack_any

    def unpack(self, words: Words, order: Order) -> float:
        return int(words[0]) * self.scale

    def unpack_many(self, words: Words, count: int, order: Order) -> NDArray[np.float64]:
        return read_only(words * self.scale)

    def pack_many(self, values: ArrayLike, count: int, order: Order) -> Words:
        numbers = _numbers(values, count, repr(self))
        with np.errstate(over="ignore"):  # infinite values are rejected below
            steps = np.rint(numbers / self.scale)
        fits = (steps >= _LEAST) & (steps <= _MOST)
        if not fits.all():
            raise BadValue(
                f"{numbers[~fits][0]} does not fit; expected {self!r}, "
                f"{_LEAST * self.scale:g} to {_MOST * self.scale:g}"
            )
        return steps.astype(np.int32)


class _Millionths(ValueType[float, NDArray[np.float64], SupportsFloat]):
    """Type for a number in two words: the whole part, and the fraction in millionths, each with the sign."""

    def __repr__(self) -> str:
        return "Millionths"

    def length(self, count: int) -> int:
        return 2 * count

    def reader(self, count: int, order: Order) -> Reader:
        if count > 1:
            return super().reader(count, order)

        def read(memory: bytearray, offset: int) -> tuple[float]:
            whole, part = _read_two_words(memory, offset)
            return (whole + part / 1e6,)

        return read

    def unpack(self, words: Words, order: Order) -> float:
        return int(words[0]) + int(words[1]) / 1e6

    def unpack_many(self, words: Words, count: int, order: Order) -> NDArray[np.float64]:
        return read_only(words[0::2] + words[1::2] / 1e6)

    def pack_many(self, values: ArrayLike, count: int, order: Order) -> Words:
        numbers = _numbers(values, count, "Millionths")
        whole = np.trunc(numbers)
        with np.errstate(invalid="ignore"):  # values that are not finite are rejected below
            part = np.rint((numbers - whole) * 1e6)
        # Rounding can turn a fraction into a whole, which is carried over.
        carried = np.abs(part) == 1e6
        whole[carried] += np.sign(part[carried])
        part[carried] = 0
        fits = (whole >= _LEAST) & (whole <= _MOST)
        if not fits.all():
            raise BadValue(f"{numbers[~fits][0]} is out of range for Millionths; expected {_LEAST} to {_MOST}")
        return np.stack((whole, part), axis=1).astype(np.int32).reshape(-1)


class Text(ValueType[str, tuple[str, ...], str]):
    """Type for text of at most `size` bytes of UTF-8, padded with NUL.

    Reading ends at the first NUL and replaces bytes that are not UTF-8.

    Raises:
        BadValue: If `size` is below 1.
    """

    def __init__(self, size: int) -> None:
        if size < 1:
            raise BadValue(f"Text({size}): expected at least 1 byte")
        self.size = size

    def __repr__(self) -> str:
        return f"Text({self.size})"

    def length(self, count: int) -> int:
        return -(-self.size * count // 4)

    def unpack_many(self, words: Words, count: int, order: Order) -> tuple[str, ...]:
        memory = _memory(words, order)
        pieces = (memory[at : at + self.size] for at in range(0, count * self.size, self.size))
        return tuple(piece.partition(b"\0")[0].decode("utf-8", "replace") for piece in pieces)

    def pack_many(self, values: ArrayLike, count: int, order: Order) -> Words:
        if not isinstance(values, (list, tuple)) or len(values) != count:
            raise BadValue(f"{values!r} is not {count} values of {self}")
        return _words(b"".join(self._encoded(each) for each in values), order)

    def _encoded(self, value: object) -> bytes:
        if not isinstance(value, str):
            raise BadValue(f"{value!r} is not text")
        try:
            raw = value.encode()
        except UnicodeEncodeError as error:
            raise BadValue(f"{value!r} is not {self}: {error}") from None
        if len(raw) > self.size or b"\0" in raw:
            raise BadValue(f"{value!r} does not fit; expected {self}: at most {self.size} bytes, none of them NUL")
        return raw.ljust(self.size, b"\0")


class Structure(ValueType[np.void, NDArray[np.void], Any]):
    """Type for a C structure, which is a structured numpy type.

    Several structures follow each other as in an array.

    Args:
        dtype: Argument of `numpy.dtype`. A type with ``align=True`` is padded as by a C compiler. The byte order of its
            fields is the order of the declaration.

    Raises:
        BadValue: If the type is not structured, or contains Python objects.
    """

    def __init__(self, dtype: DTypeLike) -> None:
        self.dtype = np.dtype(dtype)
        if self.dtype.names is None or self.dtype.hasobject or not self.dtype.itemsize:
            raise BadValue(f"{self.dtype} is not a structured type; expected named fields without Python objects")

    def __repr__(self) -> str:
        return f"Structure({self.dtype})"

    def length(self, count: int) -> int:
        return -(-self.dtype.itemsize * count // 4)

    def unpack_many(self, words: Words, count: int, order: Order) -> NDArray[np.void]:
        return np.frombuffer(_memory(words, order), self.dtype.newbyteorder(_MARK[order]), count)

    def pack_many(self, values: ArrayLike, count: int, order: Order) -> Words:
        wire = self.dtype.newbyteorder(_MARK[order])
        try:
            array = np.array(values, wire)
        except (ValueError, TypeError, OverflowError) as error:
            raise BadValue(f"{values!r} is not {count} of {self}: {error}") from None
        if array.shape != (count,):
            raise BadValue(f"{self}: expected {count} values, got an array of shape {array.shape}")
        clean = np.zeros(count, wire)
        _copy_fields(clean, array)
        return _words(clean.tobytes(), order)


def _copy_fields(to: NDArray[Any], source: NDArray[Any]) -> None:
    """Copy only the fields.

    The padding may contain memory of this program, which must not be sent.
    """
    for name in to.dtype.names or ():
        if to[name].dtype.names is None:
            to[name] = source[name]
        else:
            _copy_fields(to[name], source[name])


#: A signed 32-bit integer, the original's only type.
Int32: ValueType[int, NDArray[np.int32], SupportsIndex] = _Integer("Int32", "i4")
#: An unsigned 32-bit integer.
UInt32: ValueType[int, NDArray[np.uint32], SupportsIndex] = _Integer("UInt32", "u4")
#: A signed 64-bit integer, two words.
Int64: ValueType[int, NDArray[np.int64], SupportsIndex] = _Integer("Int64", "i8")
#: A 32-bit float. Values that it cannot hold exactly are rounded.
Float32: ValueType[float, NDArray[np.float32], SupportsFloat] = _Float("Float32", "f4")
#: A 64-bit float, two words.
Float64: ValueType[float, NDArray[np.float64], SupportsFloat] = _Float("Float64", "f8")
#: A word that is zero or not zero.
Bool: ValueType[bool, NDArray[np.bool_], bool] = _Flag()
#: A number as the original's GPS plugin sends it: whole part and millionths, two words.
Millionths: ValueType[float, NDArray[np.float64], SupportsFloat] = _Millionths()

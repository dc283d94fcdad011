"""What 32-bit words mean: numbers, text and structures, packed as a C++ program has them in memory.

The wrappers around the original copy a value's memory into as many words as it needs, and each word crosses the network
by itself (docs/protocols/rhd.md, Encoding). A double is thus two words in the order in which the robot's machine holds
them: low word first on a little-endian one, as every known robot is, high word first on a big-endian one. The ``order``
of a declaration says which. A value of one word is the same in both orders.
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

#: Which byte of a number stands first in the memory of the robot's machine.
Order = Literal["little", "big"]

#: Reads the value of a variable from the memory of a table, whose words are in the order of this machine, at an offset
#: in bytes. The value is the only item of what it returns, so that `struct.Struct.unpack_from` is one as it is.
Reader = Callable[[bytearray, int], tuple[Any, ...]]
#: Makes the words of a value; one word may be an int.
Packer = Callable[[Any], "Words | int"]

V = TypeVar("V")
A = TypeVar("A")
S = TypeVar("S")

_MARK: dict[str, Literal["<", ">"]] = {"little": "<", "big": ">"}
#: struct's letters for numpy's names.
_LETTERS = {"i4": "i", "u4": "I", "i8": "q", "f4": "f", "f8": "d"}
_WORD_SIZE = 4
#: One word, in the order of this machine.
_read_word = struct.Struct("=i").unpack_from
_read_two_words = struct.Struct("=ii").unpack_from
_ZERO = (0,)
#: What one word can hold.
_LEAST, _MOST = -(2**31), 2**31 - 1


def wrapped(count: float, bits: int = 32) -> int:
    """The nearest value of a counter of so many bits, as robots have them: after 2147483647 comes -2147483648."""
    half = 1 << (bits - 1)
    return (round(count) + half) % (2 * half) - half


class ValueType(Generic[V, A, S]):
    """The type of a variable's values: one value is a `V`, many are an `A`, and one can be set as an `S`.

    Attributes:
        unit: of its values; "" for none.
    """

    unit: str = ""

    def length(self, count: int) -> int:
        """The 32-bit words that so many values need."""
        raise NotImplementedError

    def unpack(self, words: Words, order: Order) -> V:
        """The value in the words of a variable. Never fails."""
        values: Any = self.unpack_many(words, 1, order)
        value: V = values[0]
        return value

    def unpack_many(self, words: Words, count: int, order: Order) -> A:
        """The values in the words of a variable, not changing with it. Never fails."""
        raise NotImplementedError

    def pack(self, value: S, order: Order) -> Words:
        """The words of a value; raises `BadValue`."""
        values: Any = [value]
        return self.pack_many(values, 1, order)

    def pack_many(self, values: ArrayLike, count: int, order: Order) -> Words:
        """The words of so many values; raises `BadValue`."""
        raise NotImplementedError

    def reader(self, count: int, order: Order) -> Reader:
        """A function that reads so many values as `unpack` or `unpack_many` does; quicker where a type knows how."""
        length = self.length(count)

        def read(memory: bytearray, offset: int) -> tuple[Any]:
            words = np.frombuffer(memory, np.int32, length, offset)
            return (self.unpack(words, order) if count == 1 else self.unpack_many(words, count, order),)

        return read

    def packer(self, count: int, order: Order) -> Packer:
        """A function that packs so many values as `pack` or `pack_many` does; quicker where a type knows how."""
        if count == 1:
            return lambda value: self.pack(value, order)
        return lambda values: self.pack_many(values, count, order)


def _memory(words: Words, order: Order) -> bytes:
    """The bytes that the robot's machine has in memory for these words."""
    return words.tobytes() if order == sys.byteorder else words.byteswap().tobytes()


def _words(memory: bytes, order: Order) -> Words:
    """The inverse of `_memory`; what does not fill the last word is filled with zeros."""
    words = np.frombuffer(memory + bytes(-len(memory) % 4), np.int32)
    return words if order == sys.byteorder else words.byteswap()


def _shaped(values: ArrayLike, count: int, what: str) -> NDArray[Any]:
    try:
        array = np.asarray(values)
    except (ValueError, TypeError, OverflowError) as error:
        raise BadValue(f"{values!r} is not {count} values of {what}: {error}") from None
    if array.shape != (count,):
        raise BadValue(f"{what}: expected {count} values, got the shape {array.shape}")
    return array


def _read_bool(memory: bytearray, offset: int) -> tuple[bool]:
    return (_read_word(memory, offset) != _ZERO,)


class _Number(ValueType[V, A, S]):
    """Numbers of one machine type."""

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
        # Each word is in the order of this machine, so the words are put in that of the robot's before they are one.
        read_words, write_words = struct.Struct("=II").unpack_from, struct.Struct(_MARK[order] + "II").pack
        unpack = self._structs[order].unpack
        return lambda memory, offset: unpack(write_words(*read_words(memory, offset)))

    def pack(self, value: S, order: Order) -> Words:
        return _words(self._structs[order].pack(self._checked(value)), order)

    def pack_many(self, values: ArrayLike, count: int, order: Order) -> Words:
        array = self._checked_many(_shaped(values, count, self._name))
        return _words(array.astype(self._types[order]).tobytes(), order)

    def _checked(self, value: S) -> float:
        """The number, if this type can hold it."""
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
            # struct refuses what is not a whole number of 32 bits in a tenth of the time; numpy says what was wrong.
            if type(values) is list:
                with contextlib.suppress(struct.error):
                    return np.frombuffer(pack(*values), np.int32)
            return pack_any(values)  # type: ignore[return-value]

        return pack_list

    def _checked(self, value: SupportsIndex) -> int:
        try:
            number = operator.index(value)
        except TypeError:
            raise BadValue(f"{value!r} is not a whole number; expected {self._range}") from None
        if not self._least <= number <= self._most:
            raise BadValue(f"{number} does not fit; expected {self._range}")
        return number

    def _checked_many(self, values: NDArray[Any]) -> NDArray[Any]:
        # Whole numbers beyond 64 bits come as objects: each is looked at by itself.
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
    """Values as float64; raises `BadValue` for what is not a number, text that looks like one among it."""
    array = _shaped(values, count, what)
    if array.dtype.kind not in "fiubO":
        raise BadValue(f"{values!r} is not {what}: expected numbers")
    try:
        if array.dtype.kind == "O":  # whole numbers beyond 64 bits, Decimal; numpy would make NaN of None
            return np.array([float(each) for each in array], np.float64)
        return array.astype(np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise BadValue(f"{values!r} is not {what}: {error}") from None


class _Flag(ValueType[bool, NDArray[np.bool_], bool]):
    """A word that is zero or not; written as 0 or 1."""

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
            raise BadValue(f"{values!r} is not Bool; expected True or False")
        return array.astype(np.int32)


class Scaled(ValueType[float, NDArray[np.float64], SupportsFloat]):
    """A fixed-point number: a 32-bit integer that counts steps of `scale`.

    Written values are rounded to the nearest step, where C programs drop the fraction.

    Args:
        scale: what one step is worth, in `unit`.
        unit: of the value.

    Raises:
        BadValue: a scale that is not a positive number.
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
            # Both round halves to even. Beyond a word, and for what is not a plain number, `pack` says what is wrong.
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
        with np.errstate(over="ignore"):  # what becomes infinite is refused below
            steps = np.rint(numbers / self.scale)
        fits = (steps >= _LEAST) & (steps <= _MOST)
        if not fits.all():
            raise BadValue(
                f"{numbers[~fits][0]} does not fit; expected {self!r}, "
                f"{_LEAST * self.scale:g} to {_MOST * self.scale:g}"
            )
        return steps.astype(np.int32)


class _Millionths(ValueType[float, NDArray[np.float64], SupportsFloat]):
    """A number in two words: its whole part, and its fraction in millionths, both with its sign."""

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
        with np.errstate(invalid="ignore"):  # what is not finite is refused below
            part = np.rint((numbers - whole) * 1e6)
        # A fraction of almost one is rounded up to a whole.
        carried = np.abs(part) == 1e6
        whole[carried] += np.sign(part[carried])
        part[carried] = 0
        fits = (whole >= _LEAST) & (whole <= _MOST)
        if not fits.all():
            raise BadValue(f"{numbers[~fits][0]} does not fit; expected Millionths, {_LEAST} to {_MOST}")
        return np.stack((whole, part), axis=1).astype(np.int32).reshape(-1)


class Text(ValueType[str, tuple[str, ...], str]):
    """Text of at most `size` bytes of UTF-8, filled up with NUL.

    Reading ends at the first NUL and replaces what is not UTF-8.

    Raises:
        BadValue: a size below 1.
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
    """A C structure, as a structured numpy type; several stand one after another as in an array.

    Args:
        dtype: what `numpy.dtype` takes; with ``align=True`` there it is padded as a C compiler does.
            The byte order of its fields is that of the declaration.

    Raises:
        BadValue: not a structured type, or one that holds Python objects.
    """

    def __init__(self, dtype: DTypeLike) -> None:
        self.dtype = np.dtype(dtype)
        if self.dtype.names is None or self.dtype.hasobject or not self.dtype.itemsize:
            raise BadValue(f"{self.dtype} is no structured type of plain fields")

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
            raise BadValue(f"{self}: expected {count} values, got the shape {array.shape}")
        clean = np.zeros(count, wire)
        _copy_fields(clean, array)
        return _words(clean.tobytes(), order)


def _copy_fields(to: NDArray[Any], source: NDArray[Any]) -> None:
    """Copy the fields, and not what padding holds: that is of this program's memory and nobody's business."""
    for name in to.dtype.names or ():
        if to[name].dtype.names is None:
            to[name] = source[name]
        else:
            _copy_fields(to[name], source[name])


#: A signed 32-bit integer, what the original knows.
Int32: ValueType[int, NDArray[np.int32], SupportsIndex] = _Integer("Int32", "i4")
#: An unsigned 32-bit integer.
UInt32: ValueType[int, NDArray[np.uint32], SupportsIndex] = _Integer("UInt32", "u4")
#: A signed 64-bit integer, two words.
Int64: ValueType[int, NDArray[np.int64], SupportsIndex] = _Integer("Int64", "i8")
#: A 32-bit float. What it cannot hold exactly is rounded.
Float32: ValueType[float, NDArray[np.float32], SupportsFloat] = _Float("Float32", "f4")
#: A 64-bit float, two words.
Float64: ValueType[float, NDArray[np.float64], SupportsFloat] = _Float("Float64", "f8")
#: A word that is zero or not.
Bool: ValueType[bool, NDArray[np.bool_], bool] = _Flag()
#: A number as the original's GPS plugin sends it: whole part and millionths, two words.
Millionths: ValueType[float, NDArray[np.float64], SupportsFloat] = _Millionths()

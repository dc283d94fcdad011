"""Meaning of words, compared with `struct`, which packs values in the same way as a C compiler."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from linkcore.errors import BadValue
from rhdlink.variables.value_types import (
    Bool,
    Float32,
    Float64,
    Int32,
    Int64,
    Millionths,
    Order,
    Scaled,
    Structure,
    Text,
    UInt32,
    ValueType,
)

ORDERS: list[Order] = ["little", "big"]
NUMBERS: list[tuple[ValueType[Any, Any, Any], str, st.SearchStrategy[Any]]] = [
    (Int32, "i", st.integers(-(2**31), 2**31 - 1)),
    (UInt32, "I", st.integers(0, 2**32 - 1)),
    (Int64, "q", st.integers(-(2**63), 2**63 - 1)),
    (Float32, "f", st.floats(width=32)),
    (Float64, "d", st.floats()),
]


def memory(words: Sequence[int] | np.ndarray[Any, Any], order: Order) -> bytes:
    """Return the bytes of these words in the memory of a machine with this byte order."""
    return struct.pack(f"{'<' if order == 'little' else '>'}{len(words)}i", *words)


def same(one: Any, other: Any) -> bool:
    return bool(one == other) or (math.isnan(one) and math.isnan(other))


@pytest.mark.property
@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize(("value_type", "letter", "values"), NUMBERS)
@given(st.data())
def test_numbers_have_the_memory_layout_of_c(
    value_type: ValueType[Any, Any, Any], letter: str, values: st.SearchStrategy[Any], order: Order, data: st.DataObject
) -> None:
    mark = "<" if order == "little" else ">"
    value = data.draw(values)
    words = value_type.pack(value, order)
    assert words.dtype == np.int32
    assert len(words) == value_type.length(1)
    assert memory(words, order) == struct.pack(mark + letter, value)
    assert same(value_type.unpack(words, order), value)

    many = data.draw(st.lists(values, min_size=2, max_size=5))
    words = value_type.pack_many(many, len(many), order)
    assert len(words) == value_type.length(len(many))
    assert memory(words, order) == struct.pack(f"{mark}{len(many)}{letter}", *many)
    again = value_type.unpack_many(words, len(many), order)
    assert not again.flags.writeable
    assert again.dtype.isnative
    assert all(same(one, other) for one, other in zip(again.tolist(), many, strict=True))


@pytest.mark.property
@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize(
    "value_type",
    [
        *(number for number, _, _ in NUMBERS),
        Bool,
        Millionths,
        Scaled(1e-5),
        Text(5),
        Structure([("quality", "u1"), ("age", "f8")]),
    ],
)
@given(st.data())
def test_reader_equals_unpacking_the_words(
    value_type: ValueType[Any, Any, Any], order: Order, data: st.DataObject
) -> None:
    for count in (1, data.draw(st.integers(2, 4))):
        length = value_type.length(count)
        before = data.draw(st.integers(0, 3))
        size = before + length
        words = np.array(data.draw(st.lists(st.integers(-(2**31), 2**31 - 1), min_size=size, max_size=size)), np.int32)
        memory = bytearray(words.tobytes())
        words = words[before:]
        (value,) = value_type.reader(count, order)(memory, 4 * before)
        expected = value_type.unpack(words, order) if count == 1 else value_type.unpack_many(words, count, order)
        assert type(value) is type(expected)
        # The values are compared as text, so that NaN equals NaN.
        assert repr(value) == repr(expected)
        memory[:] = bytes(len(memory))
        assert repr(value) == repr(expected)
        if isinstance(value, np.ndarray):
            assert not value.flags.writeable
            assert value.dtype == expected.dtype


#: Values that a user might set, of which few are valid.
ANYTHING = st.one_of(
    st.integers(-(2**33), 2**33),
    st.floats(),
    st.booleans(),
    st.none(),
    st.text(max_size=2),
    st.integers(-9, 9).map(np.int64),
    st.lists(st.one_of(st.integers(-(2**32), 2**32), st.integers(-9, 9), st.floats(), st.booleans()), max_size=4),
    st.lists(st.integers(-(2**31), 2**31 - 1), min_size=3, max_size=3),
)


@pytest.mark.property
@pytest.mark.parametrize("value_type", [Int32, UInt32, Float64, Bool, Scaled(0.01), Scaled(1 / 40000)], ids=repr)
@given(value=ANYTHING, count=st.sampled_from([1, 3]))
def test_packer_gives_the_same_words_and_errors_as_pack(
    value_type: ValueType[Any, Any, Any], value: Any, count: int
) -> None:
    def packed(pack: Callable[[], Any]) -> Any:
        try:
            return np.atleast_1d(pack()).tolist()
        except BadValue as error:
            return str(error)

    quickly = packed(lambda: value_type.packer(count, "little")(value))
    if count == 1:
        assert quickly == packed(lambda: value_type.pack(value, "little"))
    else:
        assert quickly == packed(lambda: value_type.pack_many(value, count, "little"))


def test_float64_word_order_follows_the_byte_order() -> None:
    assert Float64.pack(1.0, "little").tolist() == [0, 0x3FF00000]
    assert Float64.pack(1.0, "big").tolist() == [0x3FF00000, 0]


@pytest.mark.parametrize(
    ("value_type", "value"),
    [
        (Int32, 2**31),
        (Int32, -(2**31) - 1),
        (Int32, 1.0),
        (Int32, "1"),
        (Int32, None),
        (Int32, [1]),
        (UInt32, -1),
        (UInt32, 2**32),
        (Int64, 2**63),
        (Float32, 1e39),
        (Float32, "1"),
        (Float64, None),
        (Float64, 10**400),
        (Float64, [1.0]),
        (Float64, 1j),
        (Bool, 2),
        (Bool, "yes"),
        (Bool, 1.0),
        (Scaled(1e-5), 21474.83648),
        (Scaled(1e-5), -21474.9),
        (Scaled(1e-5), math.nan),
        (Scaled(1e-5), math.inf),
        (Scaled(1e-5), 1.7e308),
        (Scaled(1e-5), "fast"),
        (Millionths, 2.0**31),
        (Millionths, 2147483647.9999999),
        (Millionths, math.nan),
        (Millionths, math.inf),
        (Text(3), "four"),
        (Text(3), "äö"),
        (Text(3), "a\0"),
        (Text(3), b"abc"),
        (Text(3), "\ud800"),
        (Structure([("a", "u1")]), (256,)),
        (Structure([("a", "u1")]), ("x",)),
        (Structure([("a", "u1")]), (1, 2)),
    ],
)
@pytest.mark.parametrize("order", ORDERS)
def test_value_types_reject_invalid_values(value_type: ValueType[Any, Any, Any], value: Any, order: Order) -> None:
    with pytest.raises(BadValue):
        value_type.pack(value, order)
    with pytest.raises(BadValue):
        value_type.pack_many([value, value], 2, order)


@pytest.mark.parametrize(
    "value_type", [Int32, Int64, Float32, Float64, Bool, Scaled(0.1), Millionths, Text(4), Structure([("a", "i4")])]
)
@pytest.mark.parametrize("values", [[], [0], [0, 0, 0], 0, [[0, 0]], [[0], [0, 0]]])
def test_pack_many_rejects_a_wrong_number_of_values(value_type: ValueType[Any, Any, Any], values: Any) -> None:
    with pytest.raises(BadValue):
        value_type.pack_many(values, 2, "little")


def test_integers_of_any_type_are_packed() -> None:
    assert Int32.pack(np.int64(5), "little").tolist() == [5]
    assert Int32.pack(True, "little").tolist() == [1]
    assert Int32.pack_many(np.array([1, 2], np.uint64), 2, "little").tolist() == [1, 2]
    assert Float64.unpack(Float64.pack(np.float32(0.5), "little"), "little") == 0.5
    with pytest.raises(BadValue, match="4294967296 does not fit; expected Int32, -2147483648 to 2147483647"):
        Int32.pack_many(np.array([0, 2**32]), 2, "little")
    with pytest.raises(BadValue):
        Int64.pack_many([0, 2**64], 2, "little")


def test_bool_is_packed_and_unpacked() -> None:
    assert Bool.pack(True, "little").tolist() == [1]
    assert Bool.pack_many([True, False], 2, "little").tolist() == [1, 0]
    assert Bool.unpack(np.array([-5], np.int32), "little") is True
    assert Bool.unpack_many(np.array([-5, 0], np.int32), 2, "little").tolist() == [True, False]


@pytest.mark.property
@given(st.integers(-(2**31), 2**31 - 1), st.sampled_from([1e-5, 1 / 40000, 0.01, 1.0, 3.0]))
def test_scaled_step_survives_a_round_trip(steps: int, scale: float) -> None:
    value_type = Scaled(scale)
    value = value_type.unpack(np.array([steps], np.int32), "little")
    assert value == steps * scale
    assert value_type.pack(value, "little").tolist() == [steps]
    assert value_type.pack_many(
        value_type.unpack_many(np.array([steps] * 2, np.int32), 2, "little"), 2, "big"
    ).tolist() == [
        steps,
        steps,
    ]


def test_scaled_value_is_rounded_to_the_nearest_step() -> None:
    assert Scaled(1e-5, unit="m/s").pack(0.3, "little").tolist() == [30000]
    assert Scaled(0.01).pack_many([0.126, -0.126], 2, "little").tolist() == [13, -13]
    assert Scaled(1e-5, unit="m/s").unit == "m/s"
    assert repr(Scaled(1e-5, unit="m/s")) == "Scaled(1e-05, unit='m/s')"


@pytest.mark.parametrize("scale", [0, -1, math.inf, math.nan])
def test_scaled_rejects_invalid_scales(scale: float) -> None:
    with pytest.raises(BadValue, match="expected a positive number"):
        Scaled(scale)


def test_millionths_pack_the_sign_into_both_words() -> None:
    for value, words in ((12.5, [12, 500000]), (-12.5, [-12, -500000]), (-0.25, [0, -250000]), (1.9999999, [2, 0])):
        assert Millionths.pack(value, "little").tolist() == words
        assert Millionths.unpack(np.array(words, np.int32), "little") == pytest.approx(value, abs=1e-6)
    assert Millionths.unpack_many(np.array([1, 500000, 2, 0], np.int32), 2, "little").tolist() == [1.5, 2.0]
    assert Millionths.pack_many([1.5, -1.9999999], 2, "little").tolist() == [1, 500000, -2, 0]


@pytest.mark.property
@pytest.mark.parametrize("order", ORDERS)
@given(
    st.lists(
        st.text(st.characters(exclude_characters="\0", exclude_categories=["Cs"]), max_size=5), min_size=1, max_size=3
    )
)
def test_text_is_packed_as_its_bytes(order: Order, texts: list[str]) -> None:
    value_type = Text(21)
    raw = b"".join(text.encode().ljust(21, b"\0") for text in texts)
    words = value_type.pack_many(texts, len(texts), order)
    assert len(words) == value_type.length(len(texts))
    assert memory(words, order) == raw + bytes(-len(raw) % 4)
    assert value_type.unpack_many(words, len(texts), order) == tuple(texts)
    assert value_type.unpack(value_type.pack(texts[0], order), order) == texts[0]


def test_invalid_text_is_replaced_and_zero_length_rejected() -> None:
    assert Text(4).unpack(np.array([-1], np.int32), "little") == "\ufffd" * 4
    assert Text(3).unpack(np.array([0x64636261], np.int32), "little") == "abc"
    with pytest.raises(BadValue):
        Text(0)


@pytest.mark.property
@pytest.mark.parametrize("order", ORDERS)
@given(st.integers(0, 255), st.integers(-(2**15), 2**15 - 1), st.floats(allow_nan=False))
def test_structure_is_padded_like_in_c(order: Order, flag: int, count: int, value: float) -> None:
    dtype = np.dtype([("flag", "u1"), ("count", "i2"), ("value", "f8")], align=True)
    value_type = Structure(dtype)
    mark = "<" if order == "little" else ">"
    raw = struct.pack(f"{mark}Bxhxxxxd", flag, count, value)
    words = value_type.pack((flag, count, value), order)
    assert memory(words, order) == raw
    assert value_type.length(1) == 4
    assert value_type.unpack(words, order).tolist() == (flag, count, value)
    assert (
        value_type.unpack_many(value_type.pack_many([(flag, count, value)] * 3, 3, order), 3, order).tolist()
        == [(flag, count, value)] * 3
    )


def test_padding_of_a_nested_structure_is_zero() -> None:
    inner = np.dtype([("flag", "u1"), ("value", "f8")], align=True)
    value_type = Structure(np.dtype([("one", inner), ("two", inner, 2)], align=True))
    value = np.frombuffer(b"\xff" * value_type.dtype.itemsize, value_type.dtype)[0]
    raw = memory(value_type.pack(value, "little"), "little")
    assert raw == (b"\xff" + bytes(7) + b"\xff" * 8) * 3


@pytest.mark.parametrize("dtype", ["i4", [("a", "O")], []])
def test_structure_rejects_invalid_types(dtype: Any) -> None:
    with pytest.raises(BadValue):
        Structure(dtype)


@pytest.mark.property
@pytest.mark.parametrize("order", ORDERS)
@given(st.lists(st.integers(-(2**31), 2**31 - 1), min_size=6, max_size=6))
def test_any_words_can_be_unpacked(order: Order, numbers: list[int]) -> None:
    words = np.array(numbers, np.int32)
    for value_type in (
        Int32,
        UInt32,
        Int64,
        Float32,
        Float64,
        Bool,
        Scaled(1e-5),
        Millionths,
        Text(4),
        Structure("i4,i2,i2"),
    ):
        count = 6 // value_type.length(1)
        value_type.unpack(words[: value_type.length(1)], order)
        assert len(value_type.unpack_many(words[: value_type.length(count)], count, order)) == count

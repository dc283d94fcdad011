from __future__ import annotations

import copy
import math
import pickle
import struct
from typing import Any

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from linkcore.wire.fields import NOT_A_CODE, Coded, Float64b, Int8ub, Int16ub, Mask64, OpenInt, Raw, Shape, Text
from linkcore.wire.schema import as_construct


class Mode(OpenInt):
    IDLE = 5
    GONE = -1


def test_known_numbers_are_members() -> None:
    assert Mode(5) is Mode.IDLE
    assert Mode(-1).name == "GONE"


@given(st.integers(-(2**63), 2**64))
def test_any_whole_number_is_a_mode(number: int) -> None:
    mode = Mode(number)
    assert mode == number
    assert int(mode) == number
    assert hash(mode) == hash(number)
    assert isinstance(mode, Mode)
    assert mode.name == {5: "IDLE", -1: "GONE"}.get(number, f"UNKNOWN_{number}")
    assert pickle.loads(pickle.dumps(mode)) == copy.deepcopy(mode) == mode
    assert mode.name in repr(mode)


@pytest.mark.parametrize("value", ["IDLE", 5.5, None])
def test_what_is_no_whole_number_is_no_mode(value: Any) -> None:
    with pytest.raises(ValueError, match=r"not a (whole number|valid)"):
        Mode(value)


def test_unknown_numbers_do_not_become_members() -> None:
    Mode(77)
    assert list(Mode) == [Mode.IDLE, Mode.GONE]


def parsed(shape: Shape, data: bytes) -> Any:
    """What construct makes of these bytes."""
    return as_construct(shape).parse(data)


def built(shape: Shape, value: Any) -> Any:
    return as_construct(shape).build(value)


FLOAT_MODE = Coded(Float64b, Mode)


@given(st.floats(allow_nan=True, allow_infinity=True))
@example(-0.0)
@example(float(NOT_A_CODE))
@example(2.0**31)
def test_a_float_holds_a_code_or_none(number: float) -> None:
    assert FLOAT_MODE.read is not None
    mode = FLOAT_MODE.read(number)
    if math.isfinite(number) and abs(number) < 2**31 and number == math.floor(number):
        assert mode == number
    else:
        assert mode == NOT_A_CODE
    assert parsed(FLOAT_MODE, struct.pack(">d", number)) == mode


def test_codes_in_floats_and_integers_are_written() -> None:
    assert built(FLOAT_MODE, Mode.IDLE) == struct.pack(">d", 5.0)
    assert built(Coded(Int8ub, Mode), Mode.IDLE) == b"\x05"
    assert built(Coded(Int8ub, bool), True) == b"\x01"
    assert parsed(Coded(Int8ub, bool), b"\x02") is True


# -- digital bits: an integer on some controllers, a double on others; nobody knows which, so both must read


@given(st.integers(0, 2**48 - 1))
def test_mask_as_an_integer(mask: int) -> None:
    assert parsed(Mask64, struct.pack(">Q", mask)) == mask


@given(st.integers(0, 2**48 - 1))
def test_mask_as_a_double(mask: int) -> None:
    assert parsed(Mask64, struct.pack(">d", float(mask))) == mask


def test_the_mask_of_the_vendors_example() -> None:
    # Inputs 0 and 2: five, as the vendor's table says.
    assert parsed(Mask64, bytes.fromhex("0000000000000005")) == 5
    assert parsed(Mask64, bytes.fromhex("4014000000000000")) == 5
    assert parsed(Mask64, bytes.fromhex("0000000000030000")) == 0x30000
    assert parsed(Mask64, bytes.fromhex("4108000000000000")) == 0x30000


@pytest.mark.parametrize("number", [0.5, -1.0, math.nan, math.inf, -math.inf, 2.0**48, 1e300])
def test_what_is_no_mask_reads_as_its_bits(number: float) -> None:
    (bits,) = struct.unpack(">Q", struct.pack(">d", number))
    assert parsed(Mask64, struct.pack(">d", number)) == bits


@given(st.binary(min_size=8, max_size=8))
def test_any_eight_bytes_are_a_mask(data: bytes) -> None:
    mask = parsed(Mask64, data)
    assert type(mask) is int
    assert 0 <= mask < 2**64


# -- text


@given(st.binary(max_size=40))
@example(b"\xff\xfe plain \xc3")
def test_text_never_fails(data: bytes) -> None:
    text = parsed(Text(), data)
    text.encode("utf-8")  # no lone surrogates: it can be printed and written to a file
    try:
        assert text == data.decode("utf-8")
    except UnicodeDecodeError:
        assert "\\x" in text


@given(st.text(max_size=40))
def test_text_round_trips(text: str) -> None:
    # What cannot be encoded, a lone surrogate, is written as its escape.
    written = built(Text(), text)
    assert parsed(Text(), written) == text.encode("utf-8", "backslashreplace").decode()


def test_prefixed_text_and_bytes() -> None:
    assert parsed(Text(Int8ub), b"\x02abc") == "ab"
    assert built(Text(Int8ub), "ab") == b"\x02ab"
    assert parsed(Raw(), b"\x00\xff") == b"\x00\xff"
    assert built(Raw(Int16ub), b"xyz") == b"\x00\x03xyz"
    assert Text(least=3).least == 3

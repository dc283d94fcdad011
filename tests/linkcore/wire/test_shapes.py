"""Shapes of fields: codes, masks of digital bits, text and raw bytes."""

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


def test_known_mode_numbers_become_enum_members() -> None:
    assert Mode(5) is Mode.IDLE
    assert Mode(-1).name == "GONE"


@given(st.integers(-(2**63), 2**64))
def test_mode_accepts_any_integer(number: int) -> None:
    mode = Mode(number)
    assert mode == number
    assert int(mode) == number
    assert hash(mode) == hash(number)
    assert isinstance(mode, Mode)
    assert mode.name == {5: "IDLE", -1: "GONE"}.get(number, f"UNKNOWN_{number}")
    assert pickle.loads(pickle.dumps(mode)) == copy.deepcopy(mode) == mode
    assert mode.name in repr(mode)


@pytest.mark.parametrize("value", ["IDLE", 5.5, None])
def test_mode_rejects_non_integers(value: Any) -> None:
    with pytest.raises(ValueError, match=r"not a (whole number|valid)"):
        Mode(value)


def test_unknown_numbers_do_not_become_members() -> None:
    Mode(77)
    assert list(Mode) == [Mode.IDLE, Mode.GONE]


def parsed(shape: Shape, data: bytes) -> Any:
    """Parse the bytes with construct."""
    return as_construct(shape).parse(data)


def built(shape: Shape, value: Any) -> Any:
    return as_construct(shape).build(value)


FLOAT_MODE = Coded(Float64b, Mode)


@given(st.floats(allow_nan=True, allow_infinity=True))
@example(-0.0)
@example(float(NOT_A_CODE))
@example(2.0**31)
def test_float_that_is_not_an_integer_code_reads_as_not_a_code(number: float) -> None:
    assert FLOAT_MODE.read is not None
    mode = FLOAT_MODE.read(number)
    if math.isfinite(number) and abs(number) < 2**31 and number == math.floor(number):
        assert mode == number
    else:
        assert mode == NOT_A_CODE
    assert parsed(FLOAT_MODE, struct.pack(">d", number)) == mode


def test_coded_values_are_encoded_in_their_wire_type() -> None:
    assert built(FLOAT_MODE, Mode.IDLE) == struct.pack(">d", 5.0)
    assert built(Coded(Int8ub, Mode), Mode.IDLE) == b"\x05"
    assert built(Coded(Int8ub, bool), True) == b"\x01"
    assert parsed(Coded(Int8ub, bool), b"\x02") is True


# -- digital bits: some controllers send an integer and others a double; it is unknown which, so both must be read


@given(st.integers(0, 2**48 - 1))
def test_mask_is_read_from_an_integer(mask: int) -> None:
    assert parsed(Mask64, struct.pack(">Q", mask)) == mask


@given(st.integers(0, 2**48 - 1))
def test_mask_is_read_from_a_double(mask: int) -> None:
    assert parsed(Mask64, struct.pack(">d", float(mask))) == mask


def test_mask_of_vendor_example_is_five() -> None:
    # Inputs 0 and 2 give five, as in the vendor's table.
    assert parsed(Mask64, bytes.fromhex("0000000000000005")) == 5
    assert parsed(Mask64, bytes.fromhex("4014000000000000")) == 5
    assert parsed(Mask64, bytes.fromhex("0000000000030000")) == 0x30000
    assert parsed(Mask64, bytes.fromhex("4108000000000000")) == 0x30000


@pytest.mark.parametrize("number", [0.5, -1.0, math.nan, math.inf, -math.inf, 2.0**48, 1e300])
def test_mask_of_an_invalid_double_contains_its_raw_bits(number: float) -> None:
    (bits,) = struct.unpack(">Q", struct.pack(">d", number))
    assert parsed(Mask64, struct.pack(">d", number)) == bits


@given(st.binary(min_size=8, max_size=8))
def test_any_eight_bytes_read_as_a_mask(data: bytes) -> None:
    mask = parsed(Mask64, data)
    assert type(mask) is int
    assert 0 <= mask < 2**64


# -- text


@given(st.binary(max_size=40))
@example(b"\xff\xfe plain \xc3")
def test_text_reads_any_bytes(data: bytes) -> None:
    text = parsed(Text(), data)
    text.encode("utf-8")  # must not raise, so the text can be printed and written to a file
    try:
        assert text == data.decode("utf-8")
    except UnicodeDecodeError:
        assert "\\x" in text


@given(st.text(max_size=40))
def test_text_round_trips(text: str) -> None:
    # A lone surrogate cannot be encoded, so its escape is written.
    written = built(Text(), text)
    assert parsed(Text(), written) == text.encode("utf-8", "backslashreplace").decode()


def test_prefixed_text_and_bytes_are_read_and_written() -> None:
    assert parsed(Text(Int8ub), b"\x02abc") == "ab"
    assert built(Text(Int8ub), "ab") == b"\x02ab"
    assert parsed(Raw(), b"\x00\xff") == b"\x00\xff"
    assert built(Raw(Int16ub), b"xyz") == b"\x00\x03xyz"
    assert Text(least=3).least == 3

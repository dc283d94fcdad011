"""Numbers must behave as in C."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rhdlink.smrcl.arithmetic import (
    BINARY_FUNCTIONS,
    UNARY_FUNCTIONS,
    divide,
    format_number,
    leading_number,
    normalize_angle,
    parse_number,
    power,
    remainder_inclusive,
    remainder_modulo,
    truncate,
)

ANY = st.floats(allow_nan=True, allow_infinity=True)


@pytest.mark.parametrize(
    ("text", "value", "rest"),
    [
        ("1.5e-3x", 1.5e-3, "x"),
        ("007", 7.0, ""),
        (".5", 0.5, ""),
        ("5.", 5.0, ""),
        ("0x10", 16.0, ""),
        ("0x1p3", 8.0, ""),
        ("0xg", 0.0, "xg"),
        ("1e", 1.0, "e"),
        ("1e+", 1.0, "e+"),
        ("1.2.3", 1.2, ".3"),
        ("1e999", math.inf, ""),
        ("0x1p99999", math.inf, ""),
    ],
)
def test_numbers_are_parsed_like_strtod(text: str, value: float, rest: str) -> None:
    found = parse_number(text)
    assert found is not None
    assert (found[0], text[found[1] :]) == (value, rest)


@pytest.mark.parametrize("text", [".", "", "x", "-1"])
def test_text_that_is_not_a_number_returns_none(text: str) -> None:
    assert parse_number(text) is None


@pytest.mark.parametrize(("text", "value"), [("  -2.5x", -2.5), ("+3", 3.0), ("", None), ("-", None), ("x1", None)])
def test_leading_number_of_a_text_is_parsed(text: str, value: float | None) -> None:
    assert leading_number(text) == value


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (1e20, "100000000000000000000.000000"),
        (-0.0, "-0.000000"),
        (0.0000005, "0.000000"),
        (0.0000015, "0.000002"),
        (math.inf, "inf"),
        (-math.inf, "-inf"),
        (math.nan, "nan"),
        (-math.nan, "-nan"),
    ],
)
def test_numbers_are_formatted_like_printf(value: float, text: str) -> None:
    assert format_number(value) == text


def test_operations_that_python_rejects_have_the_result_of_c() -> None:
    assert divide(1.0, 0.0) == math.inf
    assert divide(1.0, -0.0) == -math.inf
    assert divide(-1.0, 0.0) == -math.inf
    assert math.isnan(divide(0.0, 0.0))
    assert power(0.0, -1.0) == math.inf
    assert power(-0.0, -1.0) == -math.inf
    assert power(-0.0, -2.0) == math.inf
    assert math.isnan(power(-8.0, 1 / 3))
    assert power(-10.0, 999.0) == -math.inf
    assert power(-10.0, 998.0) == math.inf
    assert power(0.0, 0.0) == 1.0
    assert UNARY_FUNCTIONS["ln"](0.0) == -math.inf
    assert math.isnan(UNARY_FUNCTIONS["ln"](-1.0))
    assert UNARY_FUNCTIONS["exp"](1000.0) == math.inf
    assert math.isnan(UNARY_FUNCTIONS["sin"](math.inf))
    assert math.isnan(UNARY_FUNCTIONS["sqrt"](-1.0))


def test_truncation_equals_the_conversion_of_c() -> None:
    assert [truncate(value) for value in (1.9, -1.9, 2147483647.9, 2147483648.0, math.nan, -math.inf)] == [
        *(1, -1, 2147483647),
        *(-(2**31),) * 3,
    ]


@pytest.mark.parametrize(
    ("a", "b", "inclusive", "modulo"),
    [
        (7, 3, 1, 1),
        (-7, 3, 2, 2),
        (7, -3, 1, 1),
        (3, 3, 3, 0),
        (6, 3, 3, 0),
        (-3, 3, 0, 0),
        (7.5, 2, 1.5, 1.5),
        (0, 3, 0, 0),
    ],
)
def test_remainder_functions_include_or_exclude_the_divisor(
    a: float, b: float, inclusive: float, modulo: float
) -> None:
    assert (remainder_inclusive(a, b), remainder_modulo(a, b)) == (inclusive, modulo)


@pytest.mark.property
@given(ANY, ANY)
def test_remainder_is_within_the_divisor_for_any_numbers(a: float, b: float) -> None:
    modulo = remainder_modulo(a, b)
    assert math.isnan(modulo) or 0.0 <= modulo < abs(b)
    inclusive = remainder_inclusive(a, b)
    assert math.isnan(inclusive) or 0.0 <= inclusive <= abs(b) or inclusive == a


@pytest.mark.property
@given(st.floats(min_value=-1e15, max_value=1e15))
def test_angle_is_normalised_to_half_a_turn(angle: float) -> None:
    normal = normalize_angle(angle)
    assert -math.pi <= normal <= math.pi
    if abs(angle) < 1e5:
        # Each subtracted turn adds a rounding error.
        assert math.isclose(math.cos(normal), math.cos(angle), abs_tol=1e-9 + 1e-12 * abs(angle))


@pytest.mark.property
@given(ANY, ANY)
def test_functions_return_a_float_for_any_number(a: float, b: float) -> None:
    for function in UNARY_FUNCTIONS.values():
        assert isinstance(function(a), float)
    for two in (*BINARY_FUNCTIONS.values(), divide, power):
        assert isinstance(two(a, b), float)


@pytest.mark.property
@given(ANY)
def test_formatted_number_is_parsed_back_to_six_decimals(value: float) -> None:
    text = format_number(value)
    if math.isfinite(value):
        found = leading_number(text)
        assert found is not None
        assert abs(found - value) <= 5e-7 * max(1.0, abs(value))

"""Values as URScript: numbers are exact and finite, and strings stay within their quotes."""

from __future__ import annotations

import math
import re
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from linkcore.errors import BadValue
from urlink.script.text import boolean, identifier, integer, number, pose, quoted, vector


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0, "0.0"),
        (-0.0, "0.0"),
        (1, "1.0"),
        (-2.5, "-2.5"),
        (1e-12, "0.0"),
        (-1e-12, "0.0"),
        (1e-9, "0.000000001"),
        (123456789.25, "123456789.25"),
        (np.float32(0.5), "0.5"),
        (np.int64(7), "7.0"),
        (math.pi, "3.1415926536"),
    ],
)
def test_number_is_written_as_decimal(value: Any, text: str) -> None:
    assert number(value) == text


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 1e9 + 1, "1", b"1", None, True, [1], 1j, 10**400])
def test_number_rejects_other_values(value: Any) -> None:
    with pytest.raises(BadValue, match="speed is"):
        number(value, "speed")


@pytest.mark.property
@given(st.floats(-1e9, 1e9))
def test_number_round_trip_is_exact_to_1e_10(value: float) -> None:
    text = number(value)
    assert re.fullmatch(r"-?[0-9]+\.[0-9]+", text)
    assert abs(float(text) - value) <= 1e-10 + 1e-15 * abs(value)


@pytest.mark.property
@given(st.text())
def test_strings_stay_in_their_quotes(text: str) -> None:
    try:
        literal = quoted(text)
    except BadValue:
        assert not text.isprintable() or '"' in text or "\\" in text
        return
    assert literal == f'"{text}"'
    # Every parser reads it as one token: one line, a quote at each end, and no backslash that could escape a quote.
    assert len(literal.splitlines()) == 1
    assert literal.count('"') == 2
    assert "\\" not in literal
    literal.encode()


@pytest.mark.parametrize(
    "text", ['"', "\\", "\n", "\r", "\t", "\0", "\x85", "\u2028", "\x1b[0m", "\ud800", 'a")\nmovej(q']
)
def test_quoted_rejects_special_characters(text: str) -> None:
    with pytest.raises(BadValue, match="title contains"):
        quoted(text, "title")


def test_quoted_rejects_non_strings() -> None:
    with pytest.raises(BadValue, match="expected a string"):
        quoted(5)


def test_vector_and_pose_are_checked() -> None:
    assert vector(range(6)) == "[0.0, 1.0, 2.0, 3.0, 4.0, 5.0]"
    assert vector(np.array([0.5, 1, 2]), 3) == "[0.5, 1.0, 2.0]"
    assert pose(np.zeros(6).tolist()) == "p[0.0, 0.0, 0.0, 0.0, 0.0, 0.0]"
    with pytest.raises(BadValue, match=r"q\[1\] is nan; expected a finite number"):
        vector([0, math.nan, 0], 3, "q")
    with pytest.raises(BadValue, match="q has 2 values; expected 6"):
        vector([0, 1], what="q")
    with pytest.raises(BadValue, match="expected 6 numbers"):
        vector(5, what="q")  # type: ignore[arg-type]


def test_integer_and_boolean_are_checked() -> None:
    assert integer(np.int32(3), 0, 5) == "3"
    assert (boolean(True), boolean(np.bool_(False))) == ("True", "False")
    for wrong in (6, -1, 2.0, True, None, "3"):
        with pytest.raises(BadValue, match="from 0 to 5"):
            integer(wrong, 0, 5)
    for wrong in (0, 1, None, "True"):
        with pytest.raises(BadValue, match="True or False"):
            boolean(wrong)


@pytest.mark.parametrize("name", ["", "1a", "a b", "a-b", "end", "def", "é", "a\n", None])
def test_identifier_rejects_invalid_names(name: object) -> None:
    with pytest.raises(BadValue):
        identifier(name)
    assert identifier("urlink_1") == "urlink_1"

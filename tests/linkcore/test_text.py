"""Text and JSON that is safe to print: no control characters, no invalid JSON."""

from __future__ import annotations

import json
import sys
import unicodedata

import pytest
from hypothesis import given
from hypothesis import strategies as st

from linkcore.text import printable, strict_json
from tests.harm import HOSTILE, assert_harmless, strict


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("plain text, 20 °C", "plain text, 20 °C"),
        ("\x1b[31mred", "\\x1b[31mred"),
        ("\x9b31m", "\\x9b31m"),
        ("abc\u202edef", "abc\\u202edef"),
        ("two\nlines\t", "two\\nlines\\t"),
        ("\x7f\ud800\ufeff", "\\x7f\\ud800\\ufeff"),
        ("日本 é", "日本 é"),
    ],
)
def test_printable_escapes_control_characters(text: str, shown: str) -> None:
    assert printable(text) == shown


@pytest.mark.property
@given(st.text(st.characters(min_codepoint=0, max_codepoint=sys.maxunicode)))
def test_printable_removes_every_control_character(text: str) -> None:
    assert all(character == " " or unicodedata.category(character)[0] not in "CZ" for character in printable(text))


def test_strict_json_replaces_nan_and_escapes_control_characters() -> None:
    value = {"a": [1.5, float("nan"), (float("-inf"),)], "b": {"c": HOSTILE}, "d": None, "e": True}
    text = strict_json(value)
    assert_harmless(text)
    assert "\n" not in text
    assert text.isascii()
    assert strict(text) == {"a": [1.5, None, [None]], "b": {"c": HOSTILE}, "d": None, "e": True}


@pytest.mark.slow
@pytest.mark.property
@given(st.recursive(st.none() | st.booleans() | st.floats() | st.text(), lambda inner: st.lists(inner)))
def test_strict_json_of_any_value_is_printable_and_valid(value: object) -> None:
    text = strict_json(value)
    assert text.isprintable()
    strict(text)


def test_strict_json_keeps_finite_numbers_exactly() -> None:
    assert json.loads(strict_json([0.1, -1e-300, 2**53])) == [0.1, -1e-300, 2**53]

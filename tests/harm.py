"""Text that would harm a terminal, and the check that it did not reach the terminal."""

from __future__ import annotations

import json
from typing import Any

#: Clears the screen, renames the window, sets a colour with C1, deletes, reverses the text direction, ends the line.
HOSTILE = "safe\x1b[2J\x1b]0;owned\x07\x9b31m\x7f\u202egnp\u2066\u2028\r\nsecond"
#: Characters that must not reach a terminal. A newline may appear only at the end of a printed line.
FORBIDDEN = "\x1b\x07\x9b\x7f\u202e\u2066\u2028\r"


def strict(text: str) -> Any:
    """Parse JSON according to the standard, without NaN and Infinity."""

    def refuse(name: str) -> Any:
        raise AssertionError(f"{name} is not valid JSON")

    return json.loads(text, parse_constant=refuse)


def assert_harmless(*texts: str) -> None:
    for text in texts:
        found = [character for character in FORBIDDEN if character in text]
        assert not found, f"{found} reached the terminal"

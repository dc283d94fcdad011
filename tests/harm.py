"""Text that would harm a terminal, and the proof that it did not get there."""

from __future__ import annotations

import json
from typing import Any

#: Clears the screen, renames the window, colours by C1, deletes, turns the direction of writing, ends the line.
HOSTILE = "safe\x1b[2J\x1b]0;owned\x07\x9b31m\x7f\u202egnp\u2066\u2028\r\nsecond"
#: None of these may reach a terminal; a newline only where a line of ours ends.
FORBIDDEN = "\x1b\x07\x9b\x7f\u202e\u2066\u2028\r"


def strict(text: str) -> Any:
    """JSON as the standard has it: without NaN and Infinity."""

    def refuse(name: str) -> Any:
        raise AssertionError(f"{name} is no JSON")

    return json.loads(text, parse_constant=refuse)


def assert_harmless(*texts: str) -> None:
    for text in texts:
        found = [character for character in FORBIDDEN if character in text]
        assert not found, f"{found} reached the terminal"

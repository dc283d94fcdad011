"""Text that is safe to show: what came over the wire never steers the terminal."""

from __future__ import annotations

import json
import math
from typing import Any

__all__ = ["safe", "strict_json"]


def safe(text: str) -> str:
    r"""`text` on one line, every character that is not printable written as its escape.

    That is all that moves the cursor, colours, renames the window, reverses the direction of writing or
    hides: control characters, ESC, C1, bidirectional overrides, line separators, lone surrogates.

    >>> safe("stop\x1b[2J\u202e\n")
    'stop\\x1b[2J\\u202e\\n'
    """
    if text.isprintable():
        return text
    return "".join(character if character.isprintable() else _escaped(character) for character in text)


def _escaped(character: str) -> str:
    return character.encode("unicode_escape").decode("ascii")


def strict_json(value: Any) -> str:
    r"""`value` as one line of JSON that any parser takes: NaN and the infinities are null, the text is ASCII.

    >>> strict_json({"q": [1.5, float("nan")], "text": "\x1b\x7f"})
    '{"q": [1.5, null], "text": "\\u001b\\u007f"}'
    """
    # DEL is ASCII to `json`, but a control character to a terminal.
    return json.dumps(_finite(value), allow_nan=False).replace("\x7f", "\\u007f")


def _finite(value: Any) -> Any:
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, dict):
        return {key: _finite(element) for key, element in value.items()}
    if isinstance(value, (list, tuple)):
        return [_finite(element) for element in value]
    return value

"""Text from elsewhere, made safe to show: what came over the wire never steers a terminal or forges a line of a log."""

from __future__ import annotations

import difflib
import json
import math
from collections.abc import Iterable
from typing import Any

__all__ = ["printable", "similar", "strict_json"]


def printable(text: object) -> str:
    r"""The text of an object on one line, every character that is not printable written as its escape.

    That is all that moves the cursor, colours, renames the window, reverses the direction of writing or hides: control
    characters, ESC, C1, bidirectional overrides, line separators, lone surrogates. Used wherever text of a peer, or an
    error that may quote some, is printed or logged.

    >>> printable("stop\x1b[2J\u202e\n")
    'stop\\x1b[2J\\u202e\\n'
    """
    shown = str(text)
    if shown.isprintable():
        return shown
    return "".join(character if character.isprintable() else _escaped(character) for character in shown)


def _escaped(character: str) -> str:
    return character.encode("unicode_escape").decode("ascii")


def similar(name: str, names: Iterable[str]) -> str:
    """ "; did you mean 'x'?", or nothing where no name is similar.

    >>> similar("moniter", ["monitor", "echo"])
    "; did you mean 'monitor'?"
    """
    known = list(names)
    found = [each for each in known if each.lower() == name.lower()] or difflib.get_close_matches(name, known, 1)
    return f"; did you mean {found[0]!r}?" if found else ""


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

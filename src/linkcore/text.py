"""Text from elsewhere, made safe to show: bytes from the wire steer no terminal, forge no log line, are not HTML.

What few programs use is imported where it is used: importing the library stays cheap.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Any


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
    return "".join(each if each.isprintable() else each.encode("unicode_escape").decode("ascii") for each in shown)


def similar(name: str, names: Iterable[str]) -> str:
    """ "; did you mean 'x'?", or nothing where no name is similar.

    >>> similar("moniter", ["monitor", "echo"])
    "; did you mean 'monitor'?"
    """
    import difflib

    known = list(names)
    found = [each for each in known if each.lower() == name.lower()] or difflib.get_close_matches(name, known, 1)
    return f"; did you mean {found[0]!r}?" if found else ""


def strict_json(value: Any) -> str:
    r"""`value` as one line of JSON that any parser takes: NaN and the infinities are null, the text is ASCII.

    >>> strict_json({"q": [1.5, float("nan")], "text": "\x1b\x7f"})
    '{"q": [1.5, null], "text": "\\u001b\\u007f"}'
    """
    import json

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


def html_table(
    caption: object, head: Sequence[str], rows: Iterable[Sequence[object]], notes: Iterable[str] = ()
) -> str:
    """A table; all texts are escaped, whatever came over the wire.

    Args:
        caption: above it.
        head: names of the columns; none for none.
        rows: the cells.
        notes: a list below it.
    """

    import html

    def cells(kind: str, texts: Sequence[object]) -> str:
        return "".join(f"<{kind}>{html.escape(str(text))}</{kind}>" for text in texts)

    body = "".join(f"<tr>{cells('td', row)}</tr>" for row in rows)
    top = f"<tr>{cells('th', head)}</tr>" if head else ""
    listed = "".join(f"<li>{html.escape(note)}</li>" for note in notes)
    below = f"<ul>{listed}</ul>" if listed else ""
    return f"<table><caption>{html.escape(str(caption))}</caption>{top}{body}</table>{below}"

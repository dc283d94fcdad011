"""Functions that make text from a peer safe for printing, for logs, and for JSON or HTML.

Bytes from the wire must not control a terminal, forge a log line, or be interpreted as HTML. Modules that few programs
need are imported inside the functions, so that importing the library stays fast.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Any


def printable(text: object) -> str:
    r"""Return the text of an object on one line, with every unprintable character replaced by its escape.

    Unprintable characters can move the cursor, set colours, rename the window, reverse the writing direction or hide
    text. They are control characters, ESC, C1, bidirectional overrides, line separators and lone surrogates. Use this
    function wherever text of a peer is printed or logged, and for errors that might quote such text.

    >>> printable("stop\x1b[2J\u202e\n")
    'stop\\x1b[2J\\u202e\\n'
    """
    shown = str(text)
    if shown.isprintable():
        return shown
    return "".join(each if each.isprintable() else each.encode("unicode_escape").decode("ascii") for each in shown)


def similar(name: str, names: Iterable[str]) -> str:
    """Return "; did you mean 'x'?", or an empty string if no name is similar.

    >>> similar("moniter", ["monitor", "echo"])
    "; did you mean 'monitor'?"
    """
    import difflib

    known = list(names)
    found = [each for each in known if each.lower() == name.lower()] or difflib.get_close_matches(name, known, 1)
    return f"; did you mean {found[0]!r}?" if found else ""


def strict_json(value: Any) -> str:
    r"""Return `value` as one line of ASCII JSON that every parser accepts; NaN and infinity become null.

    >>> strict_json({"q": [1.5, float("nan")], "text": "\x1b\x7f"})
    '{"q": [1.5, null], "text": "\\u001b\\u007f"}'
    """
    import json

    # `json` does not escape DEL, because it is ASCII; a terminal treats it as a control character.
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
    """Return an HTML table in which all texts are escaped, because they might come from a peer.

    Args:
        caption: Caption above the table.
        head: Names of the columns; empty for a table without a header row.
        rows: Rows of cells.
        notes: Items of the list below the table; empty for no list.
    """

    import html

    def cells(kind: str, texts: Sequence[object]) -> str:
        return "".join(f"<{kind}>{html.escape(str(text))}</{kind}>" for text in texts)

    body = "".join(f"<tr>{cells('td', row)}</tr>" for row in rows)
    top = f"<tr>{cells('th', head)}</tr>" if head else ""
    listed = "".join(f"<li>{html.escape(note)}</li>" for note in notes)
    below = f"<ul>{listed}</ul>" if listed else ""
    return f"<table><caption>{html.escape(str(caption))}</caption>{top}{body}</table>{below}"

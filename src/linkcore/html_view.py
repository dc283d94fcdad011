"""Tables for notebooks."""

from __future__ import annotations

import html
from collections.abc import Iterable, Sequence

__all__ = ["html_table"]


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

    def cells(kind: str, texts: Sequence[object]) -> str:
        return "".join(f"<{kind}>{html.escape(str(text))}</{kind}>" for text in texts)

    body = "".join(f"<tr>{cells('td', row)}</tr>" for row in rows)
    top = f"<tr>{cells('th', head)}</tr>" if head else ""
    listed = "".join(f"<li>{html.escape(note)}</li>" for note in notes)
    below = f"<ul>{listed}</ul>" if listed else ""
    return f"<table><caption>{html.escape(str(caption))}</caption>{top}{body}</table>{below}"

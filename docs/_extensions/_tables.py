"""Shared functions of the extensions: tables as docutils nodes, and ranges of releases as text."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from docutils import nodes

from urlink.protocol.firmware import RELEASES

__all__ = ["spans", "table"]


def spans(numbers: Sequence[int]) -> str:
    """Return rows of the firmware table as text, such as "3.5 to 3.9, 5.0 to 5.3"."""
    texts: list[str] = []
    begin = None
    for number in sorted(numbers):
        begin = number if begin is None else begin
        later = RELEASES[number + 1].since if number + 1 < len(RELEASES) else None
        first = RELEASES[begin].since
        if later is not None and later.major == first.major:
            if number + 1 in numbers:
                continue
            last = f"{later.major}.{later.minor - 1}"
            texts.append(str(first) if last == str(first) else f"{first} to {last}")
        else:
            texts.append(f"{first} and later {first.major}.x" if later is not None else f"{first} and later")
        begin = None
    return ", ".join(texts)


def table(head: Sequence[str], rows: Iterable[Sequence[str]], code: Sequence[int] = ()) -> nodes.table:
    """Return a table of plain text; the columns with the numbers in `code` are formatted as code."""
    group = nodes.tgroup(cols=len(head))
    group += [nodes.colspec(colwidth=1) for _ in head]
    group += nodes.thead("", _row([[nodes.Text(text)] for text in head]))
    body = nodes.tbody()
    for row in rows:
        cells: list[list[nodes.Node]] = []
        for number, text in enumerate(row):
            is_code = number in code and bool(text)
            cells.append([nodes.literal(text, text) if is_code else nodes.Text(text)])
        body += _row(cells)
    group += body
    # A width of "auto" lets the browser fit the columns to their text.
    made = nodes.table("", group, classes=["colwidths-auto"])
    # Wide tables scroll in their own box instead of leaving the page.
    made["classes"].append("docutils")
    return made


def _row(cells: Sequence[Sequence[nodes.Node]]) -> nodes.row:
    row = nodes.row()
    for cell in cells:
        row += nodes.entry("", nodes.paragraph("", "", *cell))
    return row

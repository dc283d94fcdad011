"""Write the generated reference tables to docs/tables/, so that they can be read without a build.

    python docs/make_tables.py           # after a change of a schema, a variable, a release or a command
    python docs/make_tables.py --check   # `nox -s docs` does this: status 1 if a file is not up to date

The pages of the documentation have the same tables, by the directives in docs/_extensions. A page that shows the text
of such a directive, as on the web page of a repository, links the file here.
"""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Callable, Iterable
from pathlib import Path

from docutils import nodes

DOCS = Path(__file__).resolve().parent
TABLES = DOCS / "tables"

sys.path.insert(0, str(DOCS / "_extensions"))

import compatibility  # noqa: E402
import dashboard  # noqa: E402
import layouts  # noqa: E402
import variables  # noqa: E402

#: Directive -> the nodes that it puts into a page.
_DIRECTIVES: dict[str, Callable[..., list[nodes.Node]]] = {
    "layouts": layouts.tables,
    "variables": variables.tables,
    "releases": compatibility.tables,
    "dashboard": dashboard.tables,
}

#: Page -> title of its tables.
PAGES = {
    "layouts": "Layouts: every field of every packet",
    "rtde-variables": "RTDE variables",
    "compatibility": "Firmware releases",
    "dashboard": "Commands of the dashboard server",
}

_PART = re.compile(r"^(#{2,3} .+)$|^```\{(\w+)\}(?: (\w+))?\n```$", re.MULTILINE)


def tables_of(page: str) -> str:
    """The headings and the generated tables of a page, as Markdown."""
    lines = [
        f"# {PAGES[page]}",
        f"`docs/make_tables.py` writes this file; do not edit it. [The page](../{page}.md) explains the columns.",
    ]
    headings: list[str] = []
    for heading, directive, argument in _PART.findall((DOCS / f"{page}.md").read_text(encoding="utf-8")):
        if heading:
            # A heading without a table below is left out, but a section keeps the heading above its own.
            headings = [*(each for each in headings if _depth(each) < _depth(heading)), heading]
        elif directive in _DIRECTIVES:
            lines += headings
            headings = []
            lines += map(_markdown, _DIRECTIVES[directive](*filter(None, [argument])))
    return "\n\n".join(lines) + "\n"


def _depth(heading: str) -> int:
    return len(heading) - len(heading.lstrip("#"))


def _markdown(node: nodes.Node) -> str:
    if not isinstance(node, nodes.table):
        text = node.astext()
        return f"**{text}**" if isinstance(node.children[0], nodes.strong) else text
    head, *body = [[_cell(entry) for entry in row.findall(nodes.entry)] for row in node.findall(nodes.row)]
    return "\n".join(map(_row, [head, ["---"] * len(head), *body]))


def _row(cells: Iterable[str]) -> str:
    return f"| {' | '.join(cells)} |"


def _cell(entry: nodes.entry) -> str:
    text = entry.astext().replace("|", "\\|").replace("\n", " ")
    return f"`{text}`" if text and any(entry.findall(nodes.literal)) else text


def main() -> int:
    """Write the files, or compare them."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--check", action="store_true", help="only compare, and write nothing")
    is_check = parser.parse_args().check
    old = []
    for page in PAGES:
        file = TABLES / f"{page}.md"
        text = tables_of(page)
        if is_check:
            old += [file.name] if not file.exists() or file.read_text(encoding="utf-8") != text else []
        else:
            TABLES.mkdir(exist_ok=True)
            file.write_text(text, encoding="utf-8")
    if old:
        print(f"docs/tables: {', '.join(old)} is not up to date; run: python docs/make_tables.py", file=sys.stderr)
    return 1 if old else 0


if __name__ == "__main__":
    sys.exit(main())

"""Write the generated reference tables to docs/tables/ for readers of the repository.

    python docs/make_tables.py
    python docs/make_tables.py --check

Run it after a change of a schema, a variable, a release or a command. With `--check` it writes nothing, and exits with
status 1 if a file is out of date; `nox -s docs` does this.

The built documentation has the same tables, which the directives in docs/_extensions generate. The web page of a
repository shows only the text of such a directive. Therefore the pages link to the files in docs/tables/.
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

#: Functions that return the nodes of a directive, by the name of the directive.
_DIRECTIVES: dict[str, Callable[..., list[nodes.Node]]] = {
    "layouts": layouts.tables,
    "variables": variables.tables,
    "releases": compatibility.tables,
    "dashboard": dashboard.tables,
}

#: Titles of the files with the tables, by the name of the page.
PAGES = {
    "layouts": "Layouts: every field of every packet",
    "rtde-variables": "RTDE variables",
    "compatibility": "Firmware releases",
    "dashboard": "Commands of the dashboard server",
}

_PART = re.compile(r"^(#{2,3} .+)$|^```\{(\w+)\}(?: (\w+))?\n```$", re.MULTILINE)


def tables_of(page: str) -> str:
    """Return the headings and the generated tables of a page, as Markdown."""
    lines = [
        f"# {PAGES[page]}",
        f"`docs/make_tables.py` writes this file; do not edit it. [The page](../{page}.md) explains the columns.",
    ]
    headings: list[str] = []
    for heading, directive, argument in _PART.findall((DOCS / f"{page}.md").read_text(encoding="utf-8")):
        if heading:
            # A heading without a table below it is left out, but a section keeps its parent heading.
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
    """Write the files, or compare them with `--check`."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--check", action="store_true", help="compare only, and write nothing")
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
        print(f"docs/tables: {', '.join(old)} is out of date; run: python docs/make_tables.py", file=sys.stderr)
    return 1 if old else 0


if __name__ == "__main__":
    sys.exit(main())

"""The directive `summary`: every name that a page documents, with its first sentence, in the order of the page.

The methods of a class are listed below the class.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

from docutils import nodes
from sphinx import addnodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective


class _Name(NamedTuple):
    anchor: str
    name: str
    text: str
    methods: list[tuple[str, str]]


class _Place(nodes.General, nodes.Element):
    """Placeholder of the summary, which is replaced when the names of the page are known."""


class SummaryDirective(SphinxDirective):
    """The summary of a page."""

    def run(self) -> list[nodes.Node]:
        """Return a placeholder."""
        return [_Place()]


def fill(app: Sphinx, document: nodes.document, page: str) -> None:
    """Replace the placeholder by a table for each section: names with links, and their first sentences."""
    for place in list(document.findall(_Place)):
        found: list[nodes.Node] = []
        for section in document.findall(nodes.section):
            rows = list(_rows(section))
            if rows:
                title = section.next_node(nodes.title)
                link = nodes.reference("", title.astext() if title else "", refid=section["ids"][0], internal=True)
                found += [nodes.paragraph("", "", nodes.strong("", "", link)), _table(rows)]
        place.replace_self(found)


def _rows(section: nodes.section) -> Iterator[_Name]:
    """Yield anchor, name, first sentence and methods of each description that is directly in a section."""
    for described in section.children:
        if not isinstance(described, addnodes.desc):
            continue
        signature, content = described[0], described[-1]
        assert isinstance(signature, addnodes.desc_signature)
        if not signature["ids"]:
            continue
        first = next((each for each in content.children if isinstance(each, nodes.paragraph)), None)
        text = "" if first is None else first.astext().partition(". ")[0].replace("\n", " ").rstrip(".:")
        methods = [
            (each[0]["ids"][0], each[0].next_node(addnodes.desc_name).astext())
            for each in content.children
            if isinstance(each, addnodes.desc) and each["objtype"] == "method" and each[0]["ids"]
        ]
        yield _Name(signature["ids"][0], signature["fullname"], text, methods)


def _table(rows: list[_Name]) -> nodes.table:
    group = nodes.tgroup(cols=2)
    group += [nodes.colspec(colwidth=1), nodes.colspec(colwidth=1)]
    body = nodes.tbody()
    for row in rows:
        cell = nodes.entry("", nodes.paragraph("", row.text))
        if row.methods:
            links = nodes.paragraph("", classes=["methods"])
            for anchor, name in row.methods:
                links += [_link(anchor, name), nodes.Text(" ")]
            cell += links
        body += nodes.row("", nodes.entry("", nodes.paragraph("", "", _link(row.anchor, row.name))), cell)
    group += body
    return nodes.table("", group, classes=["colwidths-auto", "summary"])


def _link(anchor: str, name: str) -> nodes.reference:
    return nodes.reference("", "", nodes.literal(name, name), refid=anchor, internal=True)


def setup(app: Sphinx) -> dict[str, Any]:
    """Register the directive."""
    app.add_node(_Place)
    app.add_directive("summary", SummaryDirective)
    app.connect("doctree-resolved", fill)
    return {"parallel_read_safe": True, "parallel_write_safe": True}

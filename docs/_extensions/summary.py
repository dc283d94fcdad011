"""The directive `summary`: every name that a page documents, with its first sentence, in the order of the page."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from docutils import nodes
from sphinx import addnodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective


class _Place(nodes.General, nodes.Element):
    """Where the summary goes, once the names of the page are known."""


class SummaryDirective(SphinxDirective):
    """The place of the summary."""

    def run(self) -> list[nodes.Node]:
        """Nothing yet."""
        return [_Place()]


def fill(app: Sphinx, document: nodes.document, page: str) -> None:
    """Put a table for each section in the place: a name that leads to its description, and what it is."""
    for place in list(document.findall(_Place)):
        found: list[nodes.Node] = []
        for section in document.findall(nodes.section):
            rows = list(_rows(section))
            if rows:
                title = section.next_node(nodes.title)
                link = nodes.reference("", title.astext() if title else "", refid=section["ids"][0], internal=True)
                found += [nodes.paragraph("", "", nodes.strong("", "", link)), _table(rows)]
        place.replace_self(found)


def _rows(section: nodes.section) -> Iterator[tuple[str, str, str]]:
    """Of each description that is directly in a section: its anchor, its name, and its first sentence."""
    for described in section.children:
        if not isinstance(described, addnodes.desc):
            continue
        signature, content = described[0], described[-1]
        assert isinstance(signature, addnodes.desc_signature)
        if not signature["ids"]:
            continue
        first = next((each for each in content.children if isinstance(each, nodes.paragraph)), None)
        text = "" if first is None else first.astext().partition(". ")[0].replace("\n", " ").rstrip(".:")
        yield signature["ids"][0], signature["fullname"], text


def _table(rows: list[tuple[str, str, str]]) -> nodes.table:
    group = nodes.tgroup(cols=2)
    group += [nodes.colspec(colwidth=1), nodes.colspec(colwidth=1)]
    body = nodes.tbody()
    for anchor, name, text in rows:
        link = nodes.reference("", "", nodes.literal(name, name), refid=anchor, internal=True)
        body += nodes.row(
            "",
            nodes.entry("", nodes.paragraph("", "", link)),
            nodes.entry("", nodes.paragraph("", text)),
        )
    group += body
    return nodes.table("", group, classes=["colwidths-auto", "summary"])


def setup(app: Sphinx) -> dict[str, Any]:
    """Register the directive."""
    app.add_node(_Place)
    app.add_directive("summary", SummaryDirective)
    app.connect("doctree-resolved", fill)
    return {"parallel_read_safe": True, "parallel_write_safe": True}

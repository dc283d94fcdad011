"""The directives of the page on the RHD protocol: tables of its packages, and an annotated connection.

    ```{rhd-package} ROW
    ```

    ```{rhd-connection}
    ```

The tables are generated from the declarations in `rhdlink.wire.schema`. The encoders generate the bytes, and
`rhdlink dissect` the text next to them.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from _tables import table
from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

from rhdlink.cli.dissect import lines
from rhdlink.variables import Database, TimeStamp
from rhdlink.wire.dissection import Piece, dissect
from rhdlink.wire.messages import END, encode_access, encode_ready
from rhdlink.wire.schema import INT, PACKAGES, TABLE, WORD, Package

_HEAD = ("offset", "field", "type", "bytes", "meaning")
_NUMBERS = {"i": "int32", "I": "uint32"}

#: Names of the packages on the pages. An item is shown separately from its package.
_PACKAGES = {"ACCESS": "a", "TABLE": "t", "DATA": "d", "READY": "r", "END": "e"}
_ITEMS = {"ROW": "t", "ENTRY": "d"}


class PackageDirective(SphinxDirective):
    """The fields of one package."""

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        """Return a table with one row for each field."""
        name = self.arguments[0]
        if name in _PACKAGES:
            rows = _package_rows(PACKAGES[_PACKAGES[name]])
        elif name in _ITEMS:
            rows = _item_rows(PACKAGES[_ITEMS[name]])
        else:
            raise self.error(f"there is no package {name}; there are {', '.join([*_PACKAGES, *_ITEMS])}")
        return [table(_HEAD, rows, code=(1,))]


def _package_rows(package: Package) -> Iterator[tuple[str, ...]]:
    letters = sorted({letter for second in package.second.values() for letter in second})
    second = f"the letter {' or '.join(letters)}" if letters else "any byte"
    yield "0", "type", f"the letter {package.letter}", "1", ""
    yield (
        "1",
        "access" if package.letter in "ar" else "direction" if letters else "any",
        second,
        "1",
        package.second_doc,
    )
    if package.item:
        items = "rows" if package is TABLE else "entries"
        order = "the index of a row is the id of its variable" if package is TABLE else "ids need not be in order"
        yield "2", "count", _NUMBERS["i"], str(INT.size), f"number of {items} that follow"
        yield str(2 + INT.size), items, items, "", order


def _item_rows(package: Package) -> Iterator[tuple[str, ...]]:
    offset: int | None = 0
    for field in package.item:
        number = _NUMBERS.get(field.code)
        size = None if field.words else WORD if number else int(field.code.removesuffix("s"))
        kind = "text" if number is None else f"{number}, each" if field.words == "length" else number
        if field.words == "width":
            # The usual width; the page states when it is different.
            size, kind = 2 * WORD, f"2 x {number}"
        yield "" if offset is None else str(offset), field.name, kind, "" if size is None else str(size), field.doc
        offset = None if offset is None or size is None else offset + size


class ConnectionDirective(SphinxDirective):
    """A short connection of a master in both directions, byte by byte."""

    def run(self) -> list[nodes.Node]:
        """Return the handshake, one request and its reply."""
        database = Database()
        database.read.add("tick")
        database.read.add("encl")
        database.write.add("speedl")
        database.read.set(0, 1, TimeStamp(1_700_000_000, 0))
        greeting = database.encode_handshake("w")
        database.write.set(0, 20, TimeStamp(1_700_000_000, 9_000))
        asked = encode_access("w") + encode_ready("w") + database.write.encode(np.array([0])) + END
        database.read.set(0, 2, TimeStamp(1_700_000_000, 10_000))
        answer = greeting + database.read.encode(np.array([0])) + END
        tables = {"w": tuple(database.write.rows), "r": tuple(database.read.rows)}
        from_client, from_server = list(dissect(asked, "client", tables)), list(dissect(answer, "server"))
        asks = [piece.package for piece in from_server].index("ee") + 1
        found: list[nodes.Node] = []
        for sentence, pieces in (
            ("The client sends:", from_client[:1]),
            ("The server replies with the handshake:", from_server[:asks]),
            ("The client sets speedl and requests a batch:", from_client[1:]),
            ("The server replies at its next tick:", from_server[asks:]),
        ):
            found += [nodes.paragraph("", sentence), _block(pieces)]
        return found


def _block(pieces: list[Piece]) -> nodes.literal_block:
    text = "\n".join("\n".join(lines(number, piece)) for number, piece in enumerate(pieces, 1))
    return nodes.literal_block(text, text, language="text")


def setup(app: Sphinx) -> dict[str, Any]:
    """Register the directives."""
    app.add_directive("rhd-package", PackageDirective)
    app.add_directive("rhd-connection", ConnectionDirective)
    return {"parallel_read_safe": True, "parallel_write_safe": True}

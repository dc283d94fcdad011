"""The directives of the page on RHD's wire: tables of its packages, and a connection taken apart.

    ```{rhd-package} ROW
    ```

    ```{rhd-connection}
    ```

The tables are those of the declarations in `rhdlink.schema`; the bytes come from the encoders and the words beside them
from what `rhdlink dissect` prints. Nothing of it is written down twice.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from _tables import table
from construct import ConstructError
from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

from rhdlink import Database, TimeStamp, schema
from rhdlink.cli.anatomy import Piece, dissect
from rhdlink.cli.dissect import lines
from rhdlink.wire import END, encode_access, encode_ready

_HEAD = ("offset", "field", "type", "bytes", "meaning")

#: What stands in a data package; any lengths will do, since a table of fields does not depend on them.
_DECLARED = {
    "ACCESS": schema.ACCESS,
    "TABLE": schema.TABLE,
    "ROW": schema.ROW,
    "DATA": schema.data_package([1]),
    "ENTRY": schema.entry([1]),
    "READY": schema.READY,
    "END": schema.END,
}


class PackageDirective(SphinxDirective):
    """The fields of one package."""

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        """One row for each field."""
        declared = _DECLARED.get(self.arguments[0])
        if declared is None:
            raise self.error(f"rhdlink.schema declares no {self.arguments[0]}; there are {', '.join(_DECLARED)}")
        return [table(_HEAD, _rows(declared), code=(1,))]


def _rows(declared: Any) -> Iterator[tuple[str, ...]]:
    offset: int | None = 0
    for part in declared.subcons:
        for name, kind, size, doc in _fields(part.name, part.subcon, part.docs):
            yield ("" if offset is None else str(offset), name, kind, "" if size is None else str(size), doc)
            offset = None if offset is None or size is None else offset + size


def _fields(name: str, shape: Any, doc: str) -> Iterator[tuple[str, str, int | None, str]]:
    """Name, type, bytes (None where they vary), meaning; two fields for an array with its count before it."""
    shape = _bare(shape)
    if type(shape).__name__ == "FocusedSeq":
        count = _bare(shape.subcons[0])
        yield "count", _number(count), count.sizeof(), f"how many {name} follow"
        yield name, name, None, doc
    elif type(shape).__name__ == "Const":
        yield name, f"the letter {shape.value.decode()}", len(shape.value), doc
    elif type(shape).__name__ == "ExprValidator":
        yield name, f"the letter {' or '.join(_accepted(shape))}", shape.sizeof(), doc
    elif type(shape).__name__ == "Array":
        is_fixed = isinstance(shape.count, int)
        element = _number(_bare(shape.subcon))
        kind = f"{shape.count} x {element}" if is_fixed else f"{element}, each"
        yield name, kind, shape.count * shape.subcon.sizeof() if is_fixed else None, doc
    elif type(shape).__name__ == "Bytes":
        yield name, "text", shape.length, doc
    else:
        yield name, _number(shape), shape.sizeof(), doc


def _bare(shape: Any) -> Any:
    """Without what names it, describes it or computes it when building."""
    while type(shape).__name__ in ("Renamed", "Rebuild"):
        shape = shape.subcon
    return shape


def _number(shape: Any) -> str:
    code = shape.fmtstr[-1]
    return np.dtype(f"{'u' if code.isupper() else 'i'}{shape.sizeof()}").name


def _accepted(shape: Any) -> Iterator[str]:
    for byte in range(256):
        try:
            shape.parse(bytes([byte]))
        except ConstructError:
            continue
        yield chr(byte)


class ConnectionDirective(SphinxDirective):
    """A small connection of a master, both directions, byte by byte."""

    def run(self) -> list[nodes.Node]:
        """The handshake, one request and its answer."""
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
        told: list[nodes.Node] = []
        for sentence, pieces in (
            ("The client says:", from_client[:1]),
            ("The server answers with the handshake:", from_server[:asks]),
            ("The client sets speedl, and asks:", from_client[1:]),
            ("The server answers at its next tick:", from_server[asks:]),
        ):
            told += [nodes.paragraph("", sentence), _block(pieces)]
        return told


def _block(pieces: list[Piece]) -> nodes.literal_block:
    text = "\n".join("\n".join(lines(number, piece)) for number, piece in enumerate(pieces, 1))
    return nodes.literal_block(text, text, language="text")


def setup(app: Sphinx) -> dict[str, Any]:
    """Register the directives."""
    app.add_directive("rhd-package", PackageDirective)
    app.add_directive("rhd-connection", ConnectionDirective)
    return {"parallel_read_safe": True, "parallel_write_safe": True}

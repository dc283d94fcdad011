"""Dissection of the bytes of one direction of a connection into packages.

The declarations in `schema` are used for this.

The decoders reject invalid bytes, but a dissection shows them. Every byte belongs to one piece, and an invalid piece
contains the reason.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from io import BytesIO
from typing import Any

from linkcore.errors import PacketError

from .decoder import Limits, ServerDecoder
from .messages import SymbolRow
from .schema import ACCESS, DATA, END, HEAD_SIZE, INT, PACKAGES, READY, TABLE, Package, item_schema

_DIRECTION = {"r": "read", "w": "write"}
_ROLE = {"r": "reader", "w": "master"}


@dataclass(frozen=True)
class PackagePart:
    """Part of a package: some bytes and their meaning.

    Attributes:
        offset: Offset of the first byte.
        data: The bytes.
        meaning: Meaning in words.
        content: Decoded content, ready for JSON.
    """

    offset: int
    data: bytes
    meaning: str
    content: dict[str, Any]


@dataclass
class Piece:
    """Piece of a dissection: a package, or bytes that belong to no package.

    Attributes:
        offset: Offset of the first byte.
        batch: Number of batches that ended before this piece. The handshake is the first batch.
        package: The two letters of the package; "" for other bytes.
        meaning: Meaning in words.
        parts: Parts of the piece, in order.
        error: Reason why these bytes are not a whole package; None if they are a whole package.
    """

    offset: int
    batch: int
    package: str
    meaning: str
    parts: list[PackagePart] = field(default_factory=list)
    error: str | None = None

    @property
    def size(self) -> int:
        """Number of bytes."""
        return sum(len(part.data) for part in self.parts)


def guess_sender(data: bytes) -> str:
    """ "server" or "client". A client never sends a table, and a server sends one first."""
    after = data[2:3] if data[:1] == ACCESS.letter.encode() else data[:1]
    return "server" if after == TABLE.letter.encode() else "client"


def tables_in(data: bytes) -> tuple[dict[str, tuple[SymbolRow, ...]], int | None]:
    """Return the tables in the bytes of a server, and the number of words of its time stamps.

    Return an empty mapping and None if there is no handshake.
    """
    decoder = ServerDecoder()
    decoder.feed(data)
    try:
        handshake = decoder.take_handshake()
    except PacketError:
        return {}, None
    if handshake is None:
        return {}, None
    return {"w": handshake.write, "r": handshake.read}, handshake.width


def dissect(
    data: bytes, sender: str, tables: dict[str, tuple[SymbolRow, ...]] | None = None, width: int = 2
) -> Iterator[Piece]:
    """Yield every byte of `data`, in order, as pieces.

    Args:
        data: Bytes of one direction of a connection.
        sender: "server" or "client".
        tables: Tables that the server of the connection sent. Tables in `data` itself are found automatically.
        width: Number of 32-bit words of a time stamp.
    """
    dissector = _Dissector(data, sender, dict(tables or {}), width)
    while dissector.at < len(data):
        yield dissector.next()


class _Broken(Exception):
    """The current package is incomplete or not valid."""


class _Dissector:
    def __init__(self, data: bytes, sender: str, tables: dict[str, tuple[SymbolRow, ...]], width: int) -> None:
        self.data = data
        self._stream = BytesIO(data)
        self.at = 0
        self._sender = sender
        self._tables = tables
        self._width = width
        self._batch = 0

    def next(self) -> Piece:
        """Return the next piece."""
        letters = self.data[self.at : self.at + 2].decode("latin-1")
        piece = Piece(self.at, self._batch, letters, "")
        try:
            package = self._package(piece, letters)
            if package is TABLE:
                self._add_table(piece, letters[1])
            elif package is DATA:
                self._add_data(piece, letters[1])
            else:
                piece.meaning = self._meaning(package, letters[1])
                self._add(piece, 2, piece.meaning, {})
            self._batch += package is END
        except _Broken as reason:
            piece.error = str(reason)
            piece.meaning = piece.meaning or "no package"
            # The rest is one part, because the start of the next package is unknown.
            self._add(piece, len(self.data), "", {})
        return piece

    def _package(self, piece: Piece, letters: str) -> Package:
        package = PACKAGES.get(letters[0])
        if len(letters) == 2 and package is not None and package.is_sent_by(self._sender, letters):
            return package
        piece.package = ""
        if len(letters) < 2:
            raise _Broken("one byte of a package")
        raise _Broken(
            f"{letters.encode('latin-1')!r} does not begin a package of a {self._sender}; "
            "the original takes it for the end of a batch"
        )

    def _meaning(self, package: Package, second: str) -> str:
        if package is ACCESS:
            verb = "grants" if self._sender == "server" else "asks for"
            return f"{verb} access as {_ROLE[second]}"
        if package is READY:
            return f"asks for the next batch, as {_ROLE[second]}"
        return "end of the batch"

    def _add(self, piece: Piece, size: int, meaning: str, content: dict[str, Any]) -> None:
        """Add the next bytes, up to `size`, with their meaning."""
        if data := self.data[self.at : self.at + size]:
            piece.parts.append(PackagePart(self.at, data, meaning, content))
            self.at += len(data)

    def _add_count(self, piece: Piece, most: int, what: str) -> int:
        if len(self.data) - self.at < HEAD_SIZE:
            raise _Broken("the package ends before its count")
        (count,) = INT.unpack_from(self.data, self.at + 2)
        piece.meaning = f"{what}: {count}"
        if not 0 <= count <= most:
            raise _Broken(f"the count is {count}; expected 0 to {most}")
        self._add(piece, HEAD_SIZE, piece.meaning, {"count": count})
        return int(count)

    def _add_table(self, piece: Piece, direction: str) -> None:
        count = self._add_count(piece, Limits().variables, f"table of {_DIRECTION[direction]} variables")
        rows: list[SymbolRow] = []
        item = item_schema(TABLE, (), self._width)
        for number in range(count):
            found, size = self._item(item, f"row {number}")
            name = found["name"].partition(b"\0")[0].decode("latin-1")
            rows.append(SymbolRow(name, found["length"]))
            words = f"{found['length']} word" + ("" if found["length"] == 1 else "s")
            content = {"id": number, "name": name, "length": found["length"]}
            self._add(piece, size, f"{number} {name}, {words}", content)
        self._tables[direction] = tuple(rows)

    def _add_data(self, piece: Piece, direction: str) -> None:
        what = f"values of {_DIRECTION[direction]} variables"
        if direction not in self._tables and self.data[self.at + 2 : self.at + HEAD_SIZE] != INT.pack(0):
            piece.meaning = what
            raise _Broken("the lengths of the variables are unknown; use --tables with a file of the server's bytes")
        rows = self._tables.get(direction, ())
        item = item_schema(DATA, [row.length for row in rows], self._width)
        for number in range(self._add_count(piece, len(rows), what)):
            found, size = self._item(item, f"entry {number}")
            identity, stamp, words = found["id"], list(found["stamp"]), list(found["data"])
            if self._width == 4:
                stamp = [_joined(*stamp[:2]), _joined(*stamp[2:])]
            name = rows[identity].name
            self._add(
                piece,
                size,
                f"{identity} {name} at {stamp[0]}.{stamp[1]:06d}: {' '.join(map(str, words))}",
                {"id": identity, "name": name, "stamp": stamp, "words": words},
            )

    def _item(self, item: Any, what: str) -> tuple[Any, int]:
        """Parse the fields of the current item with construct. Return them and the size in bytes."""
        from construct import CheckError, StreamError

        self._stream.seek(self.at)
        try:
            found = item.parse_stream(self._stream)
        except StreamError as error:
            raise _Broken(f"the package ends within the {str(error.path).split(' -> ')[1]} of {what}") from None
        except CheckError as error:
            raise _Broken(f"{what}: {str(error).splitlines()[-1]}") from None
        return found, self._stream.tell() - self.at


def _joined(low: int, high: int) -> int:
    """Join two words to a number of 64 bits, signed like C's times."""
    return (low | high << 32) - ((high >> 31) << 64)

"""The bytes of one direction of a connection, package by package, from the declarations in `schema`.

Where `wire` refuses, this shows: every byte is in one piece, and what cannot be is in one that says so.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

from construct import ConstructError

from linkcore.errors import PacketError

from .. import schema
from ..limits import Limits
from ..wire import Row, ServerStream

__all__ = ["Part", "Piece", "dissect", "guess_sender", "tables_in"]

_INT = struct.Struct(">i")
_TABLE = {"r": "read", "w": "write"}
#: Bytes of a package before its rows or entries.
_HEAD = 6


@dataclass(frozen=True)
class Part:
    """Some bytes of a package.

    Attributes:
        offset: of the first.
        data: the bytes.
        meaning: in words.
        content: what they say, ready for JSON.
    """

    offset: int
    data: bytes
    meaning: str
    content: dict[str, Any]


@dataclass
class Piece:
    """A package, or bytes that are none.

    Attributes:
        offset: of its first byte.
        batch: how many batches ended before it; the handshake is the first.
        package: its two letters; "" where it is none.
        meaning: in words.
        parts: its bytes, in order.
        error: why it is none, or no whole one; None where it is.
    """

    offset: int
    batch: int
    package: str
    meaning: str
    parts: list[Part] = field(default_factory=list)
    error: str | None = None

    @property
    def size(self) -> int:
        """Its bytes."""
        return sum(len(part.data) for part in self.parts)


class _Broken(Exception):
    """The package at hand cannot go on."""


def guess_sender(data: bytes) -> str:
    """ "server" or "client": a client never sends a table, and a server sends one first."""
    after = data[2:3] if data[:1] == b"a" else data[:1]
    return "server" if after == b"t" else "client"


def tables_in(data: bytes) -> tuple[dict[str, tuple[Row, ...]], int | None]:
    """The tables in what a server sent, and the words of its time stamps; nothing where there is no handshake."""
    stream = ServerStream()
    stream.feed(data)
    try:
        handshake = stream.take_handshake()
    except PacketError:
        return {}, None
    if handshake is None:
        return {}, None
    return {"w": handshake.write, "r": handshake.read}, handshake.width


def dissect(
    data: bytes, sender: str, tables: dict[str, tuple[Row, ...]] | None = None, width: int = 2
) -> Iterator[Piece]:
    """Every byte of `data`, in order.

    Args:
        data: of one direction of a connection.
        sender: "server" or "client".
        tables: what the server of the connection said; those in `data` itself are found.
        width: words of a time stamp.
    """
    cutter = _Cutter(data, sender, dict(tables or {}), width)
    while cutter.at < len(data):
        yield cutter.cut()


class _Cutter:
    def __init__(self, data: bytes, sender: str, tables: dict[str, tuple[Row, ...]], width: int) -> None:
        self.data = data
        self.at = 0
        self._is_server = sender == "server"
        self._tables = tables
        self._width = width
        self._batch = 0

    def cut(self) -> Piece:
        """The next piece."""
        head = self.data[self.at : self.at + 2]
        letters = head.decode("latin-1")
        piece = Piece(self.at, self._batch, letters, "")
        known = ("a", "t", "d") if self._is_server else ("a", "r", "d")
        try:
            if len(head) == 2 and letters[0] == "e":
                schema.END.parse(head)
                self._batch += 1
                piece.meaning = "end of the batch"
                self._add(piece, 2, "end of the batch", {})
            elif len(head) < 2 or letters[0] not in known or letters[1] not in "rw":
                piece.package = ""
                raise _Broken(
                    "one byte of a package"
                    if len(head) < 2
                    else f"{head!r} begins no package of a "
                    f"{'server' if self._is_server else 'client'}; the original takes it for the end of a batch"
                )
            elif letters[0] == "a":
                schema.ACCESS.parse(head)
                verb = "grants" if self._is_server else "asks for"
                piece.meaning = f"{verb} access as {'master' if letters[1] == 'w' else 'reader'}"
                self._add(piece, 2, piece.meaning, {})
            elif letters[0] == "r":
                schema.READY.parse(head)
                piece.meaning = f"asks for the next batch, as {'master' if letters[1] == 'w' else 'reader'}"
                self._add(piece, 2, piece.meaning, {})
            elif letters[0] == "t":
                self._cut_table(piece, letters[1])
            else:
                self._cut_data(piece, letters[1])
        except _Broken as reason:
            piece.error = str(reason)
            piece.meaning = piece.meaning or "no package"
            # Where the next package begins, nobody can know.
            self._add(piece, len(self.data) - self.at, "", {})
        return piece

    def _add(self, piece: Piece, size: int, meaning: str, content: dict[str, Any]) -> None:
        if size:
            piece.parts.append(Part(self.at, self.data[self.at : self.at + size], meaning, content))
            self.at += size

    def _count(self, piece: Piece, most: int, what: str) -> int:
        if len(self.data) - self.at < _HEAD:
            raise _Broken("cut off before its count")
        (count,) = _INT.unpack_from(self.data, self.at + 2)
        piece.meaning = f"{what}: {count}"
        if not 0 <= count <= most:
            raise _Broken(f"counts {count}; expected 0 to {most}")
        self._add(piece, _HEAD, piece.meaning, {"count": count})
        return int(count)

    def _cut_table(self, piece: Piece, direction: str) -> None:
        count = self._count(piece, Limits().variables, f"table of {_TABLE[direction]} variables")
        size = schema.ROW.sizeof()
        rows: list[Row] = []
        for number in range(count):
            chunk = self.data[self.at : self.at + size]
            if len(chunk) < size:
                raise _Broken(f"cut off in row {number}: expected {size} bytes, got {len(chunk)}")
            row = schema.ROW.parse(chunk)
            name = row.name.partition(b"\0")[0].decode("latin-1")
            rows.append(Row(name, row.length))
            words = f"{row.length} word" + ("" if row.length == 1 else "s")
            self._add(piece, size, f"{number} {name}, {words}", {"id": number, "name": name, "length": row.length})
        self._tables[direction] = tuple(rows)

    def _cut_data(self, piece: Piece, direction: str) -> None:
        rows = self._tables.get(direction)
        what = f"values of {_TABLE[direction]} variables"
        if rows is None:
            piece.meaning = what
            if len(self.data) - self.at >= _HEAD and self.data[self.at + 2 : self.at + _HEAD] == bytes(4):
                self._count(piece, 0, what)
                return
            raise _Broken("no table says how long the variables are; --tables names the file with the server's bytes")
        count = self._count(piece, len(rows), what)
        lengths = [row.length for row in rows]
        declared = schema.entry(lengths, self._width)
        for number in range(count):
            self._cut_entry(piece, rows, declared, number)

    def _cut_entry(self, piece: Piece, rows: Sequence[Row], declared: Any, number: int) -> None:
        left = len(self.data) - self.at
        if left < 4:
            raise _Broken(f"cut off in entry {number}")
        (identity,) = _INT.unpack_from(self.data, self.at)
        if not 0 <= identity < len(rows):
            raise _Broken(f"entry {number} is of variable {identity}; expected 0 to {len(rows) - 1}")
        size = 4 * (1 + self._width + max(rows[identity].length, 0))
        if left < size:
            raise _Broken(f"cut off in entry {number}: expected {size} bytes, got {left}")
        try:
            entry = declared.parse(self.data[self.at : self.at + size])
        except ConstructError as error:
            raise _Broken(f"entry {number}: {error}") from None
        words, stamp = list(entry.data), list(entry.stamp)
        if self._width == 4:
            stamp = [stamp[0] | stamp[1] << 32, stamp[2] | stamp[3] << 32]
        name = rows[identity].name
        self._add(
            piece,
            size,
            f"{identity} {name} at {stamp[0]}.{stamp[1]:06d}: {' '.join(map(str, words))}",
            {"id": identity, "name": name, "stamp": stamp, "words": words},
        )

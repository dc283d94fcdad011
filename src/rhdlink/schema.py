"""The packages on the wire, declared: the truth that pictures are drawn from and tests compare with.

Section 2 of the protocol reference. The data path (`entries`, `wire`) does not run these: a package of
a thousand entries would take milliseconds.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from construct import Array, Byte, Bytes, Const, Int32sb, Int32ub, OneOf, PrefixedArray, Struct

__all__ = ["ACCESS", "END", "NAME_SIZE", "READY", "ROW", "TABLE", "data_package", "entry"]

#: Bytes of a name on the wire: 32 and a terminating NUL.
NAME_SIZE = 33

_DIRECTION = OneOf(Bytes(1), [b"r", b"w"])
_WHOSE = "r from robot to program, w from program to robot"

#: Access request of a client, and its acknowledgement by the server.
ACCESS = Struct("type" / Const(b"a"), "access" / _DIRECTION * "r as reader, w as master")

#: A variable in a symbol table; its place in the table is its id.
ROW = Struct(
    "length" / Int32sb * "words of the variable",
    "name" / Bytes(NAME_SIZE) * "Latin-1, at most 32 characters, filled up with NUL; the last byte is NUL",
)

#: A symbol table.
TABLE = Struct(
    "type" / Const(b"t"),
    "direction" / _DIRECTION * _WHOSE,
    "rows" / PrefixedArray(Int32sb, ROW) * "the place of a row is the id of its variable",
)

#: A client asks for the next batch.
READY = Struct("type" / Const(b"r"), "access" / _DIRECTION * "as what: r as reader, w as master")

#: The end of a batch. The second byte says nothing.
END = Struct("type" / Const(b"e"), "any" / Byte * "says nothing; e by convention")


def entry(lengths: Sequence[int], width: int = 2) -> Any:
    """The value of one variable in a data package."""
    return Struct(
        "id" / Int32sb * "place of the variable in its table",
        "stamp" / Array(width, Int32ub) * "when it was set: seconds since 1970, microseconds",
        "data" / Array(lambda this: lengths[this.id], Int32sb) * "the whole variable, as many words as its table says",
    )


def data_package(lengths: Sequence[int], width: int = 2) -> Any:
    """The data package of a table whose variables have these lengths, with stamps of `width` words."""
    return Struct(
        "type" / Const(b"d"),
        "direction" / _DIRECTION * _WHOSE,
        "entries" / PrefixedArray(Int32sb, entry(lengths, width)) * "ids need not be in order",
    )

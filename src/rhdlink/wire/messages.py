"""The messages between server and client, as values, and their encoders.

A batch is the unit of the conversation: packages up to an end package (docs/protocols/rhd.md, Encoding).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from linkcore.errors import BadValue

from .data import DataPackage, Selection, Stamps, Words
from .schema import ACCESS, DATA, INT, NAME_SIZE, READY, TABLE
from .schema import END as END_PACKAGE

#: Bytes of a name that a symbol table can hold, besides the terminating NUL.
LONGEST_NAME = NAME_SIZE - 1
#: The end of a batch; its second byte says nothing, and the original sends this one.
END = 2 * END_PACKAGE.letter.encode()


class SymbolRow(NamedTuple):
    """A variable in a symbol table.

    Attributes:
        name: at most 32 characters, each a byte on the wire (Latin-1).
        length: 32-bit words.
    """

    name: str
    length: int


class Handshake(NamedTuple):
    """What a server says first.

    Attributes:
        granted: the access it gives, "r" or "w"; None if it names none, which is how the original
            refuses a second writer (docs/protocols/rhd.md, Access).
        width: words of a time stamp.
        write: the variables from program to robot, by id.
        read: the variables from robot to program, by id.
        data: a value for each of them: the write table's, then the read table's.
    """

    granted: str | None
    width: int
    write: tuple[SymbolRow, ...]
    read: tuple[SymbolRow, ...]
    data: tuple[DataPackage, DataPackage]


class Batch(NamedTuple):
    """What a server says at a sync.

    Attributes:
        data: its data packages, in order.
        size: its bytes.
    """

    data: tuple[DataPackage, ...]
    size: int


class Request(NamedTuple):
    """What a client says at a sync.

    Attributes:
        ready: "r" or "w", as what it asks for the next batch; None if it asks for none.
        data: its data packages, in order; only of write variables.
        size: its bytes.
    """

    ready: str | None
    data: tuple[DataPackage, ...]
    size: int


def encode_access(access: str) -> bytes:
    """An access request, or its acknowledgement."""
    return _letters(ACCESS.letter, access)


def encode_ready(access: str) -> bytes:
    """A client's request for the next batch; an end has to follow."""
    return _letters(READY.letter, access)


def encode_table(direction: str, rows: Sequence[SymbolRow]) -> bytes:
    """A symbol table.

    Raises:
        BadValue: a name that is longer than 32 bytes or holds a NUL, or a length below 1.
    """
    parts = [_letters(TABLE.letter, direction) + INT.pack(len(rows))]
    row_struct = TABLE.item_struct
    for name, length in rows:
        try:
            raw = name.encode("latin-1")
        except UnicodeEncodeError:
            raise BadValue(f"{name!r} cannot be a variable: it holds characters beyond Latin-1") from None
        if len(raw) > LONGEST_NAME or b"\0" in raw:
            raise BadValue(
                f"{name!r} cannot be a variable: expected at most {LONGEST_NAME} characters, none of them NUL"
            )
        if not 0 < length < 1 << 31:
            raise BadValue(f"variable {name!r} has {length} words; expected at least 1")
        parts.append(row_struct.pack(length, raw))
    return b"".join(parts)


def encode_data(direction: str, selection: Selection, values: Words, stamps: Stamps) -> bytes:
    """A data package.

    Args:
        direction: "r" or "w".
        selection: which variables.
        values: the flat storage of their table.
        stamps: the stamps of their table, shape (variables, 2).
    """
    count = len(selection.ids)
    head = _letters(DATA.letter, direction) + INT.pack(count)
    return head + selection.pack(values, stamps) if count else head


def _letters(package: str, second: str) -> bytes:
    if second not in ("r", "w"):
        raise BadValue(f"{second!r} is neither 'r' nor 'w'")
    return (package + second).encode()

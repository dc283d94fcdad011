"""Messages between server and client as Python values, and their encoders.

A batch is the unit of communication: packages up to and including an end package (docs/protocols/rhd.md, Encoding).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from linkcore.errors import BadValue

from .data import DataPackage, Selection, Stamps, Words
from .schema import ACCESS, DATA, INT, NAME_SIZE, READY, TABLE
from .schema import END as END_PACKAGE

#: Maximum number of bytes of a name in a symbol table, without the terminating NUL.
LONGEST_NAME = NAME_SIZE - 1
#: The end of a batch. Its second byte has no meaning; the original sends this one.
END = 2 * END_PACKAGE.letter.encode()


class SymbolRow(NamedTuple):
    """Row of a symbol table, which describes a variable.

    Attributes:
        name: Name of at most 32 characters, each one byte on the wire (Latin-1).
        length: Number of 32-bit words.
    """

    name: str
    length: int


class Handshake(NamedTuple):
    """First message of a server.

    Attributes:
        granted: Granted access, "r" or "w". None if the server names no access, which is how the original refuses a
            second writer (docs/protocols/rhd.md, Access).
        width: Number of 32-bit words of a time stamp.
        write: Variables from program to robot, by id.
        read: Variables from robot to program, by id.
        data: Values of all variables: the write table's package, then the read table's.
    """

    granted: str | None
    width: int
    write: tuple[SymbolRow, ...]
    read: tuple[SymbolRow, ...]
    data: tuple[DataPackage, DataPackage]


class Batch(NamedTuple):
    """Message of a server at a sync.

    Attributes:
        data: Data packages, in order.
        size: Size in bytes.
    """

    data: tuple[DataPackage, ...]
    size: int


class Request(NamedTuple):
    """Message of a client at a sync.

    Attributes:
        ready: Role in which the client requests the next batch, "r" or "w"; None if it requests none.
        data: Data packages, in order; only of write variables.
        size: Size in bytes.
    """

    ready: str | None
    data: tuple[DataPackage, ...]
    size: int


def encode_access(access: str) -> bytes:
    """Encode an access request or its acknowledgement."""
    return _letters(ACCESS.letter, access)


def encode_ready(access: str) -> bytes:
    """Encode a client's request for the next batch. An end package must follow."""
    return _letters(READY.letter, access)


def encode_table(direction: str, rows: Sequence[SymbolRow]) -> bytes:
    """Encode a symbol table.

    Raises:
        BadValue: If a name is longer than 32 bytes or contains a NUL, or a length is below 1.
    """
    parts = [_letters(TABLE.letter, direction) + INT.pack(len(rows))]
    row_struct = TABLE.item_struct
    for name, length in rows:
        try:
            raw = name.encode("latin-1")
        except UnicodeEncodeError:
            raise BadValue(
                f"{name!r} cannot be the name of a variable: it contains characters beyond Latin-1"
            ) from None
        if len(raw) > LONGEST_NAME or b"\0" in raw:
            raise BadValue(
                f"{name!r} cannot be the name of a variable; "
                f"expected at most {LONGEST_NAME} characters, none of them NUL"
            )
        if not 0 < length < 1 << 31:
            raise BadValue(f"variable {name!r} has {length} words; expected at least 1")
        parts.append(row_struct.pack(length, raw))
    return b"".join(parts)


def encode_data(direction: str, selection: Selection, values: Words, stamps: Stamps) -> bytes:
    """Encode a data package.

    Args:
        direction: "r" or "w".
        selection: Variables of the package.
        values: Flat storage of their table.
        stamps: Time stamps of their table, shape (variables, 2).
    """
    count = len(selection.ids)
    head = _letters(DATA.letter, direction) + INT.pack(count)
    return head + selection.pack(values, stamps) if count else head


def _letters(package: str, second: str) -> bytes:
    if second not in ("r", "w"):
        raise BadValue(f"{second!r} is not valid; expected 'r' or 'w'")
    return (package + second).encode()

"""Declarations of the packages of the RHD format (docs/protocols/rhd.md, Encoding).

All data on the wire is a sequence of packages. A package begins with two letters. If it has items, their count and the
items follow. All numbers are 32-bit words in network byte order, packed. A *batch* is a sequence of packages that ends
with `END`.

The data path (`data`, `messages`, `decoder`) uses the letters, struct formats and sizes of this module. It does not
interpret the declarations, because a package of a thousand entries would take milliseconds. `dissection` and the tables
in the docs interpret the declarations with construct: `schema` returns each package as a construct schema. Property
tests ensure that all three agree.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

from linkcore.errors import BadValue

if TYPE_CHECKING:
    from construct import Construct

#: Number of bytes of a word.
WORD = 4
#: Number of bytes of a name: 32 characters and a terminating NUL.
NAME_SIZE = 33
#: Possible numbers of words of a time stamp: two (canonical), or four with 64-bit builds of the ordinary sources. With
#: four, each number has 64 bits, low word first.
WIDTHS = (2, 4)


class ItemField(NamedTuple):
    """A field of an item.

    Attributes:
        name: Name of the field.
        code: Character of its struct format, or of the format of each of its words.
        doc: Description of the field.
        words: Quantity that determines the number of words, if it varies: "width" (of time stamps, the same in the
            whole connection) or "length" (of the variable).
    """

    name: str
    code: str
    doc: str
    words: str = ""


class Package(NamedTuple):
    """A package: `letter`, a second letter, and optionally a count and items.

    Attributes:
        letter: First byte.
        second: Allowed second bytes by sender; "" for any byte.
        second_doc: Meaning of the second byte.
        item: Fields of an item; empty for a package without items.
    """

    letter: str
    second: Mapping[str, str]
    second_doc: str
    item: tuple[ItemField, ...] = ()

    def is_sent_by(self, sender: str, letters: str) -> bool:
        """Whether "server" or "client" sends a package that begins with these two letters."""
        second = self.second.get(sender)
        return second is not None and letters[0] == self.letter and (not second or letters[1] in second)

    @property
    def item_struct(self) -> struct.Struct:
        """Struct format of an item whose fields all have a fixed size."""
        return struct.Struct(">" + "".join(field.code for field in self.item))


_WHOSE = "r from robot to program, w from program to robot"

#: A client requests access with its first two bytes. The server grants access with its first two bytes.
ACCESS = Package("a", {"client": "rw", "server": "rw"}, "r as reader, w as master")

#: The symbol table of one direction.
TABLE = Package(
    "t",
    {"server": "rw"},
    _WHOSE,
    (
        ItemField("length", "i", "words of the variable; the position of the row is the variable's id"),
        ItemField("name", f"{NAME_SIZE}s", "Latin-1, at most 32 characters, padded with NUL; the last byte is NUL"),
    ),
)

#: Values of variables, in any order of their ids. A package without items is legal and common.
DATA = Package(
    "d",
    {"client": "w", "server": "rw"},
    f"{_WHOSE}; a client sends only w",
    (
        ItemField("id", "i", "position of the variable in its table"),
        ItemField("stamp", "I", "time at which it was set: seconds since 1970, microseconds", "width"),
        ItemField("data", "i", "the whole variable, with the number of words in its table", "length"),
    ),
)

#: A client requests the next batch.
READY = Package("r", {"client": "rw"}, "role of the request: r as reader, w as master")

#: The end of a batch.
END = Package("e", {"client": "", "server": ""}, "no meaning; e by convention")

#: All packages: by the name that `schema` uses, and by letter.
_NAMED = {"access": ACCESS, "table": TABLE, "data": DATA, "ready": READY, "end": END}
PACKAGES = {package.letter: package for package in _NAMED.values()}

#: A count, an id or a length.
INT = struct.Struct(">i")
#: Number of bytes of a package before its items: two letters and the count.
HEAD_SIZE = 2 + INT.size


def schema(
    package: Literal["access", "table", "data", "ready", "end"],
    sender: Literal["client", "server"],
    lengths: Sequence[int] = (),
    width: int = 2,
) -> Construct[Any, Any]:
    """Return the construct schema of one package of the RHD format.

    It parses, builds and checks.

    The schema is made from the declaration that the documentation of the format shows. construct is imported by the
    first call. ``parse`` raises `construct.ConstructError` if the letters belong to another package, or if there are
    too few bytes for the count and the lengths of the variables. ``print`` shows the fields.

    Args:
        package: Name of the package; `docs/rhd-wire.md` describes each package.
        sender: Sender of the package.
        lengths: Words of each variable of the direction's table, by its id; needed for "data".
        width: Number of 32-bit words of a time stamp, 2 or 4.

    Raises:
        BadValue: If there is no such package, or the sender does not send it.

    >>> from rhdlink import schema
    >>> schema("data", "server", lengths=[1, 3]).build(
    ...     {"second": b"r", "items": [{"id": 1, "stamp": [10, 0], "data": [7, 8, 9]}]}
    ... ).hex(" ")
    '64 72 00 00 00 01 00 00 00 01 00 00 00 0a 00 00 00 00 00 00 00 07 00 00 00 08 00 00 00 09'
    """
    from construct import Byte, Bytes, Const, Int32sb, OneOf, PrefixedArray

    from linkcore.wire.schema_text import PacketStruct

    if package not in _NAMED:
        raise BadValue(f"unknown package {package!r}; expected one of {', '.join(_NAMED)}")
    declared = _NAMED[package]
    if sender not in declared.second:
        raise BadValue(f"a {sender!r} does not send {package}; expected {' or '.join(declared.second)}")
    if width not in WIDTHS:
        raise BadValue(f"width is {width!r} words; expected {' or '.join(map(str, WIDTHS))}")
    second = declared.second[sender]
    fields = [
        "letter" / Const(declared.letter.encode()),
        "second" / (OneOf(Bytes(1), [each.encode() for each in second]) if second else Byte),
    ]
    if declared.item:
        fields.append("items" / PrefixedArray(Int32sb, item_schema(declared, lengths, width)))
    return PacketStruct(package, *fields)


def item_schema(package: Package, lengths: Sequence[int], width: int) -> Any:
    """Return the schema of one item of a package. For `lengths` and `width`, see `schema`."""
    import construct

    words = {"i": construct.Int32sb, "I": construct.Int32ub}

    def known(identity: int, context: Any) -> int:
        if not 0 <= identity < len(lengths):
            raise construct.CheckError(f"the id of the variable is {identity}; expected 0 to {len(lengths) - 1}")
        if lengths[identity] < 0:
            raise construct.CheckError(f"the variable has {lengths[identity]} words; expected 0 or more")
        return identity

    def shape(field: ItemField) -> Any:
        if field.words == "width":
            return construct.Array(width, words[field.code])
        if field.words == "length":
            return construct.Array(lambda context: lengths[context.id], words[field.code])
        if field.name == "id":
            return construct.ExprAdapter(words[field.code], known, known)
        return words[field.code] if field.code in words else construct.Bytes(int(field.code.removesuffix("s")))

    return construct.Struct(*(field.name / shape(field) for field in package.item))

"""The packages of the RHD format, declared once (docs/protocols/rhd.md, Encoding).

Everything on the wire is a row of packages: two letters and, where a package has items, their count and the items.
All numbers are 32-bit words in network byte order, packed. A *batch* is a row of packages closed by `END`.

The data path (`data`, `messages`, `decoder`) takes letters, struct formats and sizes from here but does not interpret
the declarations: a package of a thousand entries would take milliseconds. `dissection` and the tables in the docs do
interpret them, by construct: `schema` has each package as a construct schema. Property tests hold the three equal.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

from linkcore.errors import BadValue

if TYPE_CHECKING:
    from construct import Construct

#: Bytes of a word.
WORD = 4
#: Bytes of a name: 32 characters and a terminating NUL.
NAME_SIZE = 33
#: Words of a time stamp: the canonical two, and the four of 64-bit builds of the ordinary sources, where each number
#: is a 64-bit one, low word first.
WIDTHS = (2, 4)


class ItemField(NamedTuple):
    """A field of an item.

    Attributes:
        name: what it is called.
        code: its struct format character, or that of each of its words.
        doc: what it is.
        words: what says how many words it has, where that varies: "width" (of time stamps, the same in the whole
            connection) or "length" (of the variable).
    """

    name: str
    code: str
    doc: str
    words: str = ""


class Package(NamedTuple):
    """A package: `letter`, a second letter, and for one with items their count and the items.

    Attributes:
        letter: the first byte.
        second: who sends it -> what the second byte may be; "" for anything.
        second_doc: what the second byte says.
        item: the fields of an item; none for a package without items.
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
        """The format of an item whose fields are all of fixed size."""
        return struct.Struct(">" + "".join(field.code for field in self.item))


_WHOSE = "r from robot to program, w from program to robot"

#: A client asks for access with its first two bytes; the server grants it with its first two.
ACCESS = Package("a", {"client": "rw", "server": "rw"}, "r as reader, w as master")

#: The symbol table of one direction.
TABLE = Package(
    "t",
    {"server": "rw"},
    _WHOSE,
    (
        ItemField("length", "i", "words of the variable; the place of the row is the variable's id"),
        ItemField("name", f"{NAME_SIZE}s", "Latin-1, at most 32 characters, filled up with NUL; the last byte is NUL"),
    ),
)

#: Values of variables, in any order of their ids. Without items it is legal and common.
DATA = Package(
    "d",
    {"client": "w", "server": "rw"},
    f"{_WHOSE}; a client sends w only",
    (
        ItemField("id", "i", "place of the variable in its table"),
        ItemField("stamp", "I", "when it was set: seconds since 1970, microseconds", "width"),
        ItemField("data", "i", "the whole variable, as many words as its table says", "length"),
    ),
)

#: A client asks for the next batch.
READY = Package("r", {"client": "rw"}, "as what it asks: r as reader, w as master")

#: The end of a batch.
END = Package("e", {"client": "", "server": ""}, "says nothing; e by convention")

#: All packages, by the names that `schema` takes, and by their letter.
_NAMED = {"access": ACCESS, "table": TABLE, "data": DATA, "ready": READY, "end": END}
PACKAGES = {package.letter: package for package in _NAMED.values()}

#: A count, an id or a length.
INT = struct.Struct(">i")
#: Bytes of a package before its items: two letters and the count.
HEAD_SIZE = 2 + INT.size


def schema(
    package: Literal["access", "table", "data", "ready", "end"],
    sender: Literal["client", "server"],
    lengths: Sequence[int] = (),
    width: int = 2,
) -> Construct[Any, Any]:
    """The construct schema of one package of the RHD format: it parses, builds and checks.

    Made of the declaration that the pages of the format show. construct is imported with the first call. ``parse``
    raises `construct.ConstructError` where the letters are not those of the package, and where there are fewer bytes
    than its count and the lengths of its variables ask for. ``print`` shows the fields.

    Args:
        package: which; `docs/rhd-wire.md` has what each is for.
        sender: who sends it.
        lengths: words of each variable of the direction's table, by its id; needed for "data".
        width: words of a time stamp, 2 or 4.

    Raises:
        BadValue: no such package, or the sender sends none.

    >>> from rhdlink import schema
    >>> schema("data", "server", lengths=[1, 3]).build(
    ...     {"second": b"r", "items": [{"id": 1, "stamp": [10, 0], "data": [7, 8, 9]}]}
    ... ).hex(" ")
    '64 72 00 00 00 01 00 00 00 01 00 00 00 0a 00 00 00 00 00 00 00 07 00 00 00 08 00 00 00 09'
    """
    from construct import Byte, Bytes, Const, Int32sb, OneOf, PrefixedArray

    from linkcore.wire.schema_text import PacketStruct

    if package not in _NAMED:
        raise BadValue(f"no package {package!r}; expected one of {', '.join(_NAMED)}")
    declared = _NAMED[package]
    if sender not in declared.second:
        raise BadValue(f"a {sender!r} sends no {package}; expected {' or '.join(declared.second)}")
    if width not in WIDTHS:
        raise BadValue(f"{width!r} words of a time stamp; expected {' or '.join(map(str, WIDTHS))}")
    second = declared.second[sender]
    fields = [
        "letter" / Const(declared.letter.encode()),
        "second" / (OneOf(Bytes(1), [each.encode() for each in second]) if second else Byte),
    ]
    if declared.item:
        fields.append("items" / PrefixedArray(Int32sb, item_schema(declared, lengths, width)))
    return PacketStruct(package, *fields)


def item_schema(package: Package, lengths: Sequence[int], width: int) -> Any:
    """One item of a package; `lengths` and `width` as in `schema`."""
    import construct

    words = {"i": construct.Int32sb, "I": construct.Int32ub}

    def known(identity: int, context: Any) -> int:
        if not 0 <= identity < len(lengths):
            raise construct.CheckError(f"of variable {identity}; expected 0 to {len(lengths) - 1}")
        if lengths[identity] < 0:
            raise construct.CheckError(f"of a variable of {lengths[identity]} words")
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

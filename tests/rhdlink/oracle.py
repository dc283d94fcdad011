"""construct's reading of the declarations in `rhdlink.wire.schema`: slow, and made by nobody of this project."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from construct import Array, Byte, Bytes, Const, Int32sb, Int32ub, OneOf, PrefixedArray, Struct

from rhdlink.wire.schema import Field, Package

_WORDS = {"i": Int32sb, "I": Int32ub}


def as_construct(package: Package, sender: str, lengths: Sequence[int] = (), width: int = 2) -> Any:
    """The package as `sender` sends it, of a table whose variables have these lengths."""
    second = package.second[sender]
    fields = [
        "letter" / Const(package.letter.encode()),
        "second" / (OneOf(Bytes(1), [each.encode() for each in second]) if second else Byte),
    ]
    if package.item:
        item = Struct(*(field.name / _shape(field, lengths, width) for field in package.item))
        fields.append("items" / PrefixedArray(Int32sb, item))
    return Struct(*fields)


def _shape(field: Field, lengths: Sequence[int], width: int) -> Any:
    if field.words == "width":
        return Array(width, _WORDS[field.code])
    if field.words == "length":
        return Array(lambda this: lengths[this.id], _WORDS[field.code])
    return _WORDS[field.code] if field.code in _WORDS else Bytes(int(field.code.removesuffix("s")))

"""What the words of a variable mean, where its name is one that everybody uses.

A robot tells names and lengths, and neither types nor units. The ready-made classes know them for the conventional
names; they are taken where direction and length are theirs, too.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from linkcore.cli.terminal import safe

from ..database import TimeStamp
from ..entries import Words
from ..robots import Ackerman, Gps, Smr, VelocityOmega
from ..snapshot import Variable
from ..variables import Declaration

__all__ = ["as_json", "in_units", "stamp_text", "unit_of", "words_text"]

#: Words of a variable that are shown on one line.
_MOST_WORDS = 16


def _known() -> dict[tuple[str, str, int], Declaration[Any, Any]]:
    known: dict[tuple[str, str, int], Declaration[Any, Any]] = {}
    for robot in (Smr, VelocityOmega, Ackerman, Gps):
        for declaration in robot.declared().values():
            known.setdefault((declaration.direction, declaration.name, declaration.length), declaration)
    return known


_KNOWN = _known()


def unit_of(direction: str, name: str, length: int) -> str:
    """The conventional unit of a variable; "" for none."""
    declaration = _KNOWN.get((direction, name, length))
    return "" if declaration is None else declaration.unit


def in_units(direction: str, name: str, words: Words) -> str:
    """The value with its unit: ``0.3 m/s``; "" where the name has none."""
    declaration = _KNOWN.get((direction, name, len(words)))
    if declaration is None or not declaration.unit:
        return ""
    value = declaration.unpack(words, declaration.order or "little")
    if isinstance(value, (np.ndarray, tuple)):
        text = " ".join(f"{each:.6g}" for each in value)
    else:
        text = f"{value:.6g}" if isinstance(value, float) else str(value)
    return f"{text} {declaration.unit}"


def words_text(words: Sequence[int] | Words, most: int | None = _MOST_WORDS) -> str:
    """The words of a variable, on one line."""
    shown = [str(int(word)) for word in words[:most]]
    left = len(words) - len(shown)
    return " ".join(shown) + (f" … {left} more" if left else "")


def stamp_text(stamp: TimeStamp) -> str:
    """A time stamp as the wire has it: seconds since 1970."""
    return f"{stamp.seconds}.{stamp.microseconds:06d}"


def as_json(variable: Variable) -> dict[str, Any]:
    """A variable as a JSON object; its value always as a list of words."""
    words = variable.value
    return {
        "name": variable.name,
        "direction": variable.direction,
        "id": variable.identity,
        "length": variable.length,
        "words": words.tolist(),
        "stamp": [variable.stamp.seconds, variable.stamp.microseconds],
        "meaning": in_units(variable.direction, variable.name, words) or None,
    }


def as_columns(variable: Variable) -> tuple[str, ...]:
    """A variable for a table: direction, id, name, words, meaning, time stamp."""
    meaning = in_units(variable.direction, variable.name, variable.value)
    return (
        {"r": "read", "w": "write"}[variable.direction],
        str(variable.identity),
        safe(variable.name),
        words_text(variable.value),
        f"= {meaning}" if meaning else "",
        stamp_text(variable.stamp),
    )

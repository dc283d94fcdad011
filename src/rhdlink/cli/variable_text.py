"""Variables of a robot as text and as JSON: their words, and the meaning of the words.

A robot sends names and lengths of variables, but no types and units. The ready-made classes declare the types and units
of conventional names. A declaration is used only if its direction and its length match the variable.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable
from typing import TYPE_CHECKING, Any

import numpy as np

from linkcore.errors import BadValue
from linkcore.text import printable

from ..client import Variables
from ..errors import NotThere
from ..robots import Ackerman, Gps, Robobot, Smr, VelocityOmega
from ..variables.declarations import Declaration
from ..variables.snapshot import Update, Variable
from ..variables.value_types import Bool, Float32, Float64, Int32, Int64, Millionths, Order, UInt32, ValueType
from ..wire.data import Words

if TYPE_CHECKING:
    pass

_TYPES: tuple[ValueType[Any, Any, Any], ...] = (Int32, UInt32, Int64, Float32, Float64, Bool, Millionths)
#: Types that can be selected on the command line: "int32", "uint32", ...
TYPES = {repr(each).lower(): each for each in _TYPES}

#: Maximum number of words of a variable on one line.
_MOST_WORDS = 16


def _known() -> dict[tuple[str, str, int], Declaration[Any, Any]]:
    known: dict[tuple[str, str, int], Declaration[Any, Any]] = {}
    for robot in (Smr, VelocityOmega, Ackerman, Gps, Robobot):
        for declaration in robot.declared().values():
            known.setdefault((declaration.direction, declaration.name, declaration.length), declaration)
    return known


_KNOWN = _known()


def in_units(direction: str, name: str, words: Words) -> str:
    """Format the value with its unit: ``0.3 m/s``; "" if the name has no unit."""
    declaration = _KNOWN.get((direction, name, len(words)))
    if declaration is None or not declaration.unit:
        return ""
    value = declaration.unpack(words, declaration.order or "little")
    if isinstance(value, (np.ndarray, tuple)):
        text = " ".join(f"{each:.6g}" for each in value)
    else:
        text = f"{value:.6g}" if isinstance(value, float) else str(value)
    return f"{text} {declaration.unit}"


def words_of(value: int | Words) -> Words:
    """Return the words of an undeclared variable. Its value is an int or an array; see `Variable`."""
    return np.atleast_1d(np.asarray(value, np.int32))


def typed(name: str, words: Words, type_name: str, order: Order) -> list[int | float | bool]:
    """Convert the words of a variable to values.

    Raises:
        BadValue: If the number of words is not a multiple of the length of the type.
    """
    value_type = TYPES[type_name]
    size = value_type.length(1)
    count, left = divmod(len(words), size)
    if left or not count:
        raise BadValue(f"{name} has {len(words)} words; a value of {type_name} needs {size}")
    found: list[int | float | bool] = np.atleast_1d(value_type.unpack_many(words, count, order)).tolist()
    return found


def words_text(words: Words, most: int | None = _MOST_WORDS) -> str:
    """Format the words of a variable on one line."""
    shown = [str(int(word)) for word in words[:most]]
    left = len(words) - len(shown)
    return " ".join(shown) + (f" … {left} more" if left else "")


def with_meaning(direction: str, name: str, words: Words, most: int | None = _MOST_WORDS) -> str:
    """Format up to `most` words of a variable, with their meaning if the name has one: ``30000 = 0.3 m/s``."""
    meaning = in_units(direction, name, words)
    return words_text(words, most) + (f" = {meaning}" if meaning else "")


def as_json(variable: Variable) -> dict[str, Any]:
    """Convert a variable to a JSON object, with its value as a list of words."""
    words = words_of(variable.value)
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
    """Format a variable for a table: direction, id, name, words, meaning, time stamp."""
    words = words_of(variable.value)
    meaning = in_units(variable.direction, variable.name, words)
    return (
        {"r": "read", "w": "write"}[variable.direction],
        str(variable.identity),
        printable(variable.name),
        words_text(words),
        f"= {meaning}" if meaning else "",
        f"{variable.stamp.seconds}.{variable.stamp.microseconds:06d}",
    )


def update_as_json(update: Update) -> dict[str, Any]:
    """Convert an update to a JSON object: the values, and their arrival time."""
    return {
        "received": update.received.wall,
        "variables": {name: words_of(change.value).tolist() for name, change in update.changes.items()},
        "stamps": {name: list(change.stamp) for name, change in update.changes.items()},
    }


def check_names(names: Iterable[str], robot: Variables | Collection[str], where: str) -> None:
    """Raise `NotThere` if some names are not variables."""
    missing = [name for name in names if name not in robot]
    if missing:
        raise NotThere(f"{where} has no variable {', '.join(map(repr, missing))}; `rhdlink vars` lists all")

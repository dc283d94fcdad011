"""Values as URScript text, and blocks of lines.

A value is rejected if the controller could not read back exactly the same value. Numbers have no exponent, because it
is unknown whether older controllers can read one. Strings contain no quotes, backslashes or control characters: no
escapes of URScript are known, and a backslash before the closing quote might be one.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from textwrap import dedent, indent
from typing import Any

from linkcore.arguments import check_number, whole_number
from linkcore.errors import BadValue

#: Digits after the point: quantities are exact to 1e-10.
_DIGITS = 10
#: Larger than any quantity of an arm.
_LARGEST = 1e9

_IDENTIFIER = re.compile(r"[A-Za-z_][A-Za-z0-9_]*\Z")
#: Words that cannot be names.
KEYWORDS = {
    *("and", "break", "def", "elif", "else", "end", "False", "global", "halt", "if", "join", "kill", "local"),
    *("not", "or", "return", "run", "sec", "thread", "True", "while", "xor"),
}


def boolean(value: object, what: str = "value") -> str:
    """Format a boolean as ``True`` or ``False``.

    Raises:
        BadValue: If `value` is neither True nor False.
    """
    # Booleans of numpy are not of type bool.
    if isinstance(value, bool) or type(value).__name__ in ("bool_", "bool"):
        return "True" if value else "False"
    raise BadValue(f"{what} is {value!r}; expected True or False")


def integer(value: Any, least: int, most: int, what: str = "value") -> str:
    """Format a whole number from `least` to `most`.

    Raises:
        BadValue: If it is not a whole number, or out of range.
    """
    whole = whole_number(value, least, most)
    if whole is None:
        raise BadValue(f"{what} is {value!r}; expected a whole number from {least} to {most}")
    return str(whole)


def number(value: Any, what: str = "value", least: float = -_LARGEST, most: float = _LARGEST, unit: str = "") -> str:
    """Format a finite number from `least` to `most` with a decimal point.

    >>> number(0.5), number(2), number(-1e-12), number(1 / 3)
    ('0.5', '2.0', '0.0', '0.3333333333')

    Raises:
        BadValue: If it is not a number, or out of range.
    """
    digits = f"{check_number(value, what, least, most, unit):.{_DIGITS}f}".rstrip("0")
    digits += "0" if digits.endswith(".") else ""
    return "0.0" if digits == "-0.0" else digits


def floats(values: Iterable[Any], length: int, what: str) -> list[float]:
    """Convert values to a list of `length` finite numbers.

    >>> floats((1, 2), 2, "value")
    [1.0, 2.0]

    Raises:
        BadValue: If there are more or fewer values, or one is not a finite number.
    """
    try:
        if isinstance(values, (str, bytes)):
            raise TypeError
        items = list(values)
    except TypeError:
        raise BadValue(f"{what} is {values!r}; expected {length} numbers") from None
    if len(items) != length:
        raise BadValue(f"{what} has {len(items)} values; expected {length}")
    return [check_number(item, f"{what}[{index}]") for index, item in enumerate(items)]


def vector(values: Iterable[Any], length: int = 6, what: str = "value") -> str:
    """Format a list of numbers, such as six joints or a centre of gravity.

    >>> vector([1, 2, 3], 3)
    '[1.0, 2.0, 3.0]'

    Raises:
        BadValue: If there are more or fewer values, or one is not finite.
    """
    return f"[{', '.join(map(number, floats(values, length, what)))}]"


def pose(values: Sequence[Any], what: str = "pose") -> str:
    """Format a pose: position in m, rotation vector in rad.

    >>> pose([0.1, 0, 0, 0, 0, 0])
    'p[0.1, 0.0, 0.0, 0.0, 0.0, 0.0]'

    Raises:
        BadValue: If it does not have six finite numbers.
    """
    return f"p{vector(values, 6, what)}"


def quoted(text: object, what: str = "text") -> str:
    """Format a string in quotes.

    >>> quoted("done")
    '"done"'

    Raises:
        BadValue: If it contains quotes, backslashes, line breaks or control characters, which URScript cannot hold.
    """
    if not isinstance(text, str):
        raise BadValue(f"{what} is {text!r}; expected a string")
    for at, character in enumerate(text):
        if character in '"\\' or not character.isprintable() or "\ud800" <= character <= "\udfff":
            raise BadValue(
                f"{what} contains {character!r} at position {at}; "
                "URScript strings cannot contain quotes, backslashes, line breaks or control characters"
            )
    return f'"{text}"'


def identifier(name: object, what: str = "name") -> str:
    """Check and return a name: letters, digits and underscores, not beginning with a digit.

    Raises:
        BadValue: If `name` is not a valid name, or is a keyword of URScript.
    """
    if not isinstance(name, str) or not _IDENTIFIER.match(name) or name in KEYWORDS:
        raise BadValue(f"{what} is {name!r}; expected letters, digits and underscores, but no URScript keyword")
    return name


def each(template: str, ways: Sequence[str] = ("",) * 6) -> str:
    """Return six items: `{i}` counts from 0, `{n}` from 1, `{q}` is the index in an answer, `{way}` is from `ways`."""
    return ", ".join(template.format(i=i, n=i + 1, q=i + 2, way=way) for i, way in enumerate(ways))


def lines(text: str) -> list[str]:
    """Return the lines of a program text that is indented like the surrounding Python code."""
    return [line.rstrip() for line in dedent(text).splitlines() if line.strip()]


def indented(text: str, columns: int = 8) -> str:
    """Return the lines of a part of a program, indented for insertion into another text."""
    return indent("\n".join(lines(text)), " " * columns)

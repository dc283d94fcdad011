"""What built-in functions ask of their arguments."""

from __future__ import annotations

from typing import Any

from ..errors import Fault, type_error
from ..values import NUMBERS, Pose, type_name

__all__ = ["boolean", "integer", "is_list", "joints", "number", "numbers", "pose", "six", "string", "vector"]


def number(value: Any, what: str) -> float:
    """A number."""
    if isinstance(value, (int, float)) and not isinstance(value, bool):
        return value
    raise type_error(f"{what} is a number, not {type_name(value)}")


def integer(value: Any, what: str, low: int = -(2**31), high: int = 2**31 - 1) -> int:
    """An integer, or a float that is one (a guess), of a range."""
    if value.__class__ is float and value.is_integer():
        value = int(value)
    if value.__class__ is not int:
        raise type_error(f"{what} is an integer, not {type_name(value)}")
    if not low <= value <= high:
        raise Fault(f"{what} is from {low} to {high}, not {value}")
    return int(value)


def boolean(value: Any, what: str) -> bool:
    """A truth value."""
    if value is True or value is False:
        return bool(value)
    raise type_error(f"{what} is True or False, not {type_name(value)}")


def string(value: Any, what: str) -> str:
    """A string."""
    if value.__class__ is str:
        return value
    raise type_error(f"{what} is a string, not {type_name(value)}")


def is_list(value: Any) -> bool:
    """A list, and no pose."""
    return value.__class__ is tuple


def numbers(value: Any, what: str) -> list[float]:
    """The numbers of a list or pose."""
    if value.__class__ is not tuple and value.__class__ is not Pose:
        raise type_error(f"{what} is a list, not {type_name(value)}")
    for item in value:
        if item.__class__ not in NUMBERS:
            raise type_error(f"{what} is a list of numbers, with a {type_name(item)} in it")
    return list(value)


def vector(value: Any, what: str, length: int) -> list[float]:
    """A list of so many numbers."""
    found = numbers(value, what)
    if len(found) != length:
        raise Fault(f"{what} is {length} numbers, not {len(found)}")
    return [float(item) for item in found]


def joints(value: Any, what: str) -> list[float]:
    """A list of six numbers that is no pose."""
    if value.__class__ is Pose:
        raise type_error(f"{what} is a list, not a pose")
    return vector(value, what, 6)


def six(value: Any, what: str) -> list[float]:
    """Six numbers, a list or a pose."""
    return vector(value, what, 6)


def pose(value: Any, what: str) -> list[float]:
    """The six numbers of a pose."""
    if value.__class__ is not Pose:
        raise type_error(f"{what} is a pose, not {type_name(value)}")
    return vector(value, what, 6)

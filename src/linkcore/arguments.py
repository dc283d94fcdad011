"""Checks of arguments, for many functions. The errors contain the given value and the expected values."""

from __future__ import annotations

import contextlib
import math
import operator
import threading
from collections.abc import Sequence
from typing import Any

from .errors import BadValue

#: Maximum wait of `wait=True`, in s.
_WAIT = 60.0

#: Larger than every quantity of a robot, in any unit.
_LARGEST = 1e9
_DEGREES = 180.0 / math.pi
#: Factor for the guess of a wrong unit: a value that exceeds its limits by a smaller factor is assumed to be in the
#: right unit.
_FAR = 1.25
#: Expected unit -> another unit that the caller might have used, and its number per expected unit, such as 1000 mm in 1
#: m.
_OTHER_UNITS = {
    "m": ("mm", 1e3),
    "m/s": ("mm/s", 1e3),
    "m/s²": ("mm/s²", 1e3),
    "rad": ("degrees", _DEGREES),
    "rad/s": ("degrees/s", _DEGREES),
    "rad/s²": ("degrees/s²", _DEGREES),
    "kg": ("g", 1e3),
    "s": ("ms", 1e3),
}


def check_seconds(value: Any, name: str, *, positive: bool = False, finite: bool = False) -> float:
    """Return `value` as a number of seconds, 0 or more.

    A finite number must not exceed the longest wait that the operating system supports (`threading.TIMEOUT_MAX`).
    Otherwise the wait itself would raise `OverflowError`, after a command was sent.

    Args:
        value: Argument of the caller.
        name: Name of the argument, used in the error.
        positive: Whether 0 is rejected.
        finite: Whether infinity, and any number above `threading.TIMEOUT_MAX`, is rejected.

    Raises:
        BadValue: If `value` is not a number, is NaN, or is out of the allowed range.
    """
    try:
        seconds = math.nan if isinstance(value, (bool, str, bytes)) else float(value)
    except (TypeError, ValueError, OverflowError):
        seconds = math.nan
    longest = threading.TIMEOUT_MAX if finite else math.inf
    if (seconds > 0 or (seconds == 0 and not positive)) and seconds <= longest:
        return seconds
    expected = "a positive number of seconds" if positive else "a number of seconds, 0 or more"
    limit = f", at most {threading.TIMEOUT_MAX:.4g}" if seconds > longest else ""
    raise BadValue(f"{name}={value!r}; expected {expected}{limit}")


def check_wait(value: bool | float) -> float:
    """Return the seconds of an argument ``wait=``: 0 for False (no wait), and 60 for True.

    Raises:
        BadValue: If `value` is neither a bool nor a finite number of seconds, or if it is too large. See
            `check_seconds`.
    """
    if isinstance(value, bool):
        return _WAIT if value else 0.0
    return check_seconds(value, "wait", finite=True)


def check_number(
    value: Any, name: str, least: float = -_LARGEST, most: float = _LARGEST, unit: str = "", limit_of: str = ""
) -> float:
    """Return `value` as a finite number from `least` to `most`.

    Args:
        value: Argument of the caller.
        name: Name of the argument, used in the error.
        least: Smallest allowed number.
        most: Largest allowed number.
        unit: Unit of the value and of the limits, such as ``"m/s"``; empty for a number without a unit.
        limit_of: Name of the object that has these limits, used in the error; empty if they apply everywhere.

    Raises:
        BadValue: If `value` is not a number, or is out of range. The message has the value, the limits and the unit. If
            the value would be within the limits when read in another unit, the message asks whether this unit was
            meant.
    """
    try:
        # Numpy has its own boolean type.
        if isinstance(value, (str, bytes)) or type(value).__name__ in ("bool_", "bool"):
            raise TypeError
        real = float(value)
    except (TypeError, ValueError, OverflowError):
        raise BadValue(f"{name} is {value!r}; expected a number") from None
    if not math.isfinite(real):
        raise BadValue(f"{name} is {value!r}; expected a finite number")
    of_unit = unit and f" {unit}"
    if not least <= real <= most:
        limits = f"{least:g} to {most:g}{of_unit}{limit_of and f', the limits of {limit_of}'}"
        raise BadValue(
            f"{name} is {real:g}{of_unit}; expected a number from {limits}{other_unit(real, unit, least, most)}"
        )
    return real


def other_unit(value: float, unit: str, least: float, most: float) -> str:
    """Return a question for the end of an error message: was the value given in another unit?

    The question names millimetres, degrees or another unit in which the value would be within its limits. If there is
    no such unit, return an empty string.

    >>> other_unit(50.0, "m/s", 0.001, 5.0)
    ' (in mm/s?)'
    >>> other_unit(1e6, "m/s", 0.001, 5.0)
    ''
    """
    name, factor = _OTHER_UNITS.get(unit, ("", 1.0))
    # A value that is only slightly too large is in the right unit.
    is_far = abs(value) >= _FAR * max(abs(least), abs(most))
    return f" (in {name}?)" if name and is_far and least <= value / factor <= most else ""


def check_whole(value: Any, name: str, least: int, most: int) -> int:
    """Return `value`, a Python or numpy integer, as a whole number from `least` to `most`.

    Raises:
        BadValue: If `value` is not a whole number, or is out of range.
    """
    whole = whole_number(value, least, most)
    if whole is None:
        raise BadValue(f"{name}={value!r}; expected a whole number from {least} to {most}")
    return whole


def whole_number(value: Any, least: int, most: int) -> int | None:
    """Return `value` as a whole number, or None if it is not an integer from `least` to `most`."""
    with contextlib.suppress(TypeError):
        whole = operator.index(value)
        if not isinstance(value, bool) and least <= whole <= most:
            return whole
    return None


def check_choice(value: Any, name: str, choices: Sequence[Any]) -> None:
    """Raise `BadValue` unless `value` is one of the choices."""
    if value not in choices:
        raise BadValue(f"{name}={value!r}; expected {' or '.join(map(repr, choices))}")


def check_fields(fields: Sequence[Any]) -> None:
    """Check the field names that a caller passed as separate arguments.

    Raises:
        BadValue: If an argument is not a string, for example if it is a list of names.
    """
    for field in fields:
        if not isinstance(field, str):
            raise BadValue(
                f"field {field!r} is not a string; expected each name as an argument, such as 'q_actual', 'q_target'"
            )


def element_of(name: str) -> tuple[str, int] | None:
    """Return the field and the index of an element from its name in exported files.

    Return None for any other name.

    >>> element_of("q_actual_3"), element_of("q_actual")
    (('q_actual', 3), None)
    """
    field, _, index = name.rpartition("_")
    return (field, int(index)) if field and index.isdecimal() and index.isascii() else None


def check_callable(value: Any, name: str) -> None:
    """Raise `BadValue` unless `value` is callable."""
    if not callable(value):
        raise BadValue(f"{name}={value!r}; expected a function or something else that can be called")


class Default(float):
    """Default value of an argument that another argument overrides; see `check_overridden`.

    The object is a float, so signatures show the number. Its class shows that the caller has omitted the argument.
    """

    __slots__ = ()


def check_overridden(reason: str, **given: Any) -> None:
    """Raise `BadValue` if an argument was given that would be ignored.

    >>> check_overridden("time sets the duration", speed=Default(1.05), delay=None)

    Args:
        reason: Why the arguments would be ignored.
        given: Arguments by name. A `Default` or None means that the caller has omitted the argument.

    Raises:
        BadValue: If any other value was given.
    """
    for name, value in given.items():
        if value is not None and not isinstance(value, Default):
            raise BadValue(f"{name}={value!r} would be ignored, since {reason}; omit {name}")

"""Checks of arguments that many calls share: an error says what was given and what was expected."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from .errors import BadValue

__all__ = ["check_callable", "check_choice", "check_seconds", "check_wait", "check_whole"]

#: Seconds that `wait=True` waits.
_WAIT = 60.0


def check_seconds(value: Any, name: str, *, positive: bool = False, finite: bool = False) -> float:
    """`value` as a number of seconds, 0 or more; infinity is one, unless it has to be `finite`.

    Args:
        value: what the caller was given.
        name: what the caller calls it.
        positive: 0 will not do.
        finite: infinity will not do.

    Raises:
        BadValue: it is no number, not a number (NaN), or below what is allowed.
    """
    try:
        seconds = math.nan if isinstance(value, (str, bytes)) else float(value)
    except (TypeError, ValueError):
        seconds = math.nan
    if (seconds > 0 or (seconds == 0 and not positive)) and not (finite and seconds == math.inf):
        return seconds
    expected = "a positive number of seconds" if positive else "a number of seconds, 0 or more"
    raise BadValue(f"{name}={value!r}; expected {expected}")


def check_wait(value: bool | float) -> float:
    """The seconds of an argument ``wait=``: 0 for False, which does not wait, and 60 for True.

    Raises:
        BadValue: neither of the two, and no finite number of seconds.
    """
    if isinstance(value, bool):
        return _WAIT if value else 0.0
    return check_seconds(value, "wait", finite=True)


def check_whole(value: Any, name: str, least: int, most: int) -> None:
    """Raise `BadValue` unless `value` is a whole number from `least` to `most`."""
    if not isinstance(value, int) or not least <= value <= most:
        raise BadValue(f"{name}={value!r}; expected a whole number from {least} to {most}")


def check_choice(value: Any, name: str, choices: Sequence[Any]) -> None:
    """Raise `BadValue` unless `value` is one of the choices."""
    if value not in choices:
        raise BadValue(f"{name}={value!r}; expected {' or '.join(map(repr, choices))}")


def check_callable(value: Any, name: str) -> None:
    """Raise `BadValue` unless `value` can be called."""
    if not callable(value):
        raise BadValue(f"{name}={value!r}; expected a function or something else that can be called")

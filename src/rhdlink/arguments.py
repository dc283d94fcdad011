"""Checks of arguments that several public functions share; what they raise says what was expected."""

from __future__ import annotations

import math
from collections.abc import Sequence
from numbers import Real

from linkcore.errors import BadValue

__all__ = ["check_choice", "check_seconds", "check_whole"]


def check_seconds(name: str, value: object, more: str = "") -> None:
    """Raise `BadValue` for what is no positive, finite number; `more` says what else is allowed."""
    if not isinstance(value, Real) or not 0 < float(value) < math.inf:
        raise BadValue(f"{name} is {value!r}; expected a positive number of seconds{more}")


def check_whole(name: str, value: object, least: int, most: int) -> None:
    """Raise `BadValue` for what is no whole number from `least` to `most`."""
    if not isinstance(value, int) or not least <= value <= most:
        raise BadValue(f"{name} is {value!r}; expected a whole number from {least} to {most}")


def check_choice(name: str, value: object, choices: Sequence[object]) -> None:
    """Raise `BadValue` for what is none of the choices."""
    if value not in choices:
        raise BadValue(f"{name} is {value!r}; expected {' or '.join(map(repr, choices))}")

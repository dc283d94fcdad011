"""Declaration of built-in functions, and checks of their arguments.

A built-in function is a Python function. Its arguments are the calling thread and the parameters of the URScript
function, with the same names and defaults. A function that takes time is a generator, which yields once for every cycle
that it waits.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

from linkcore.wire.fields import Since
from urlink.protocol.firmware import Firmware

from ..errors import Fault, type_error
from ..values import NUMBERS, PoseValue, type_name

F = TypeVar("F", bound=Callable[..., Any])

#: Default value that marks a required parameter.
REQUIRED = inspect.Parameter.empty


@dataclass(frozen=True, eq=False)
class Builtin:
    """Built-in function of URScript.

    Attributes:
        function: Python function. It is called with the thread and all parameters as positional arguments.
        parameters: Names and default values of the parameters.
        takes_time: Whether the function takes time, and is therefore a generator.
        in_secondary: Whether a `sec` program may call it.
        is_variadic: Whether the function accepts any arguments, with or without names.
        since: First firmware of each generation that has the function.
        until: First firmware that does not have the function, or has another form of it.
    """

    function: Callable[..., Any]
    parameters: tuple[tuple[str, Any], ...]
    takes_time: bool
    in_secondary: bool
    is_variadic: bool
    since: Since
    until: Since | None

    def is_in(self, firmware: Firmware) -> bool:
        """Whether the firmware has the function."""
        return firmware in self.since and (self.until is None or firmware not in self.until)


#: Name -> forms of the function. Each firmware has at most one of these forms.
BUILTINS: dict[str, list[Builtin]] = {}


def declare(
    *aliases: str,
    name: str | None = None,
    takes_time: bool = False,
    in_secondary: bool = True,
    since: str = "1.0",
    until: str | None = None,
) -> Callable[[F], F]:
    """Return a decorator that adds a function to `BUILTINS`, under its own name or `name`, and under aliases."""

    def enter(function: F) -> F:
        signature = list(inspect.signature(function).parameters.values())[1:]
        builtin = Builtin(
            function,
            tuple((p.name, p.default) for p in signature if p.kind is p.POSITIONAL_OR_KEYWORD),
            takes_time,
            in_secondary,
            any(p.kind is p.VAR_POSITIONAL for p in signature),
            Since(since),
            Since(until) if until else None,
        )
        for known in (name or function.__name__, *aliases):
            BUILTINS.setdefault(known, []).append(builtin)
        return function

    return enter


# -- checks of arguments --------------------------------------------------------------------------------


def number(value: Any, what: str) -> float:
    """Return a value, after checking that it is a number."""
    if isinstance(value, (int, float)) and not isinstance(value, bool):
        return value
    raise type_error(f"{what} has the type {type_name(value)}; expected a number")


def number_within(value: Any, what: str, low: float, high: float) -> float:
    """Return a value, after checking that it is a number from `low` to `high`."""
    found = number(value, what)
    if not low <= found <= high:
        raise Fault(f"{what} is {found:g}; expected {low:g} to {high:g}")
    return found


def integer(value: Any, what: str, low: int = -(2**31), high: int = 2**31 - 1) -> int:
    """Return an integer from `low` to `high`. A float with such a value is accepted too (assumed)."""
    if value.__class__ is float and value.is_integer():
        value = int(value)
    if value.__class__ is not int:
        raise type_error(f"{what} has the type {type_name(value)}; expected an integer")
    if not low <= value <= high:
        raise Fault(f"{what} is {value}; expected {low} to {high}")
    return int(value)


def boolean(value: Any, what: str) -> bool:
    """Return a value, after checking that it is a truth value."""
    if value is True or value is False:
        return bool(value)
    raise type_error(f"{what} has the type {type_name(value)}; expected True or False")


def string(value: Any, what: str) -> str:
    """Return a value, after checking that it is a string."""
    if value.__class__ is str:
        return value
    raise type_error(f"{what} has the type {type_name(value)}; expected a string")


def is_list(value: Any) -> bool:
    """Whether a value is a list rather than a pose."""
    return value.__class__ is tuple


def numbers(value: Any, what: str) -> list[float]:
    """Return the numbers of a list or pose."""
    if value.__class__ is not tuple and value.__class__ is not PoseValue:
        raise type_error(f"{what} has the type {type_name(value)}; expected a list")
    for item in value:
        if item.__class__ not in NUMBERS:
            raise type_error(f"{what} contains a value of type {type_name(item)}; expected only numbers")
    return list(value)


def vector(value: Any, what: str, length: int) -> list[float]:
    """Return the numbers of a list or pose of this length."""
    found = numbers(value, what)
    if len(found) != length:
        raise Fault(f"{what} has {len(found)} numbers; expected {length}")
    return [float(item) for item in found]


def joints(value: Any, what: str) -> list[float]:
    """Return six numbers from a list. A pose is rejected."""
    if value.__class__ is PoseValue:
        raise type_error(f"{what} is a pose; expected a list")
    return vector(value, what, 6)


def joints_or(value: Any, present: Sequence[float], what: str) -> list[float]:
    """Return six numbers from a list; `present` if the value is None."""
    return list(present) if value is None else joints(value, what)


def six(value: Any, what: str) -> list[float]:
    """Return six numbers from a list or a pose."""
    return vector(value, what, 6)


def pose(value: Any, what: str) -> list[float]:
    """Return the six numbers of a pose."""
    if value.__class__ is not PoseValue:
        raise type_error(f"{what} has the type {type_name(value)}; expected a pose")
    return vector(value, what, 6)

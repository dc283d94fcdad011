"""Expressions as Python functions of the frame.

The common cases, numbers in variables, are handled in the function itself; everything else is left to `values`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from operator import itemgetter
from typing import Any

from . import values
from .code import GLOBALS, THREAD, Frame
from .errors import Fault, ScriptError, type_error
from .limits import MAX_INTEGER, MIN_INTEGER
from .values import NUMBERS, UNSET, Pose

__all__ = [
    "Function",
    "Place",
    "both",
    "call",
    "checked_truth",
    "constant",
    "display",
    "either",
    "element",
    "failing",
    "global_variable",
    "inverted",
    "local_variable",
    "operation",
    "placed",
    "pose_display",
    "signed",
    "temporary",
    "truth",
]

Function = Callable[[Frame], Any]
Place = tuple[int, int]


def placed(function: Function, place: Place) -> Function:
    """The same, but its faults say where they happened."""
    line, column = place

    def run(f: Frame) -> Any:
        try:
            return function(f)
        except Fault as fault:
            raise ScriptError(line, column, str(fault)) from None

    return run


def failing(text: str) -> Function:
    """A run-time error."""

    def run(f: Frame) -> Any:
        raise Fault(text)

    return run


def constant(value: Any) -> Function:
    """Always the same."""
    return lambda f: value


def temporary(slot: int) -> Function:
    """What an earlier instruction left in a slot."""
    return itemgetter(slot)


def local_variable(slot: int, name: str, place: Place) -> Function:
    """A variable of the function."""
    line, column = place

    def run(f: Frame) -> Any:
        value = f[slot]
        if value is UNSET:
            raise ScriptError(line, column, f"The variable '{name}' has no value")
        return value

    return run


def global_variable(slot: int, name: str, place: Place) -> Function:
    """A variable of the program."""
    line, column = place

    def run(f: Frame) -> Any:
        value = f[GLOBALS][slot]
        if value is UNSET:
            raise ScriptError(line, column, f"The variable '{name}' has no value")
        return value

    return run


def display(items: Sequence[Function], place: Place) -> Function:
    """A list."""

    def run(f: Frame) -> Any:
        return values.list_of([item(f) for item in items], f[THREAD].machine.charge)

    return placed(run, place)


def pose_display(items: Sequence[Function], place: Place) -> Function:
    """A pose."""

    def run(f: Frame) -> Any:
        made = [item(f) for item in items]
        for number in made:
            if number.__class__ not in NUMBERS:
                raise type_error(f"{values.type_name(number)} in a pose")
        return Pose(made)

    return placed(run, place)


def element(base: Function, index: Function, place: Place) -> Function:
    """`base[index]`"""
    line, column = place

    def run(f: Frame) -> Any:
        value, at = base(f), index(f)
        if at.__class__ is int and at >= 0 and (value.__class__ is tuple or value.__class__ is Pose):
            try:
                return value[at]
            except IndexError:
                pass
        try:
            return values.element(value, at)
        except Fault as fault:
            raise ScriptError(line, column, str(fault)) from None

    return run


def truth(value: Any) -> bool:
    """Of a condition."""
    return value if value is True or value is False else values.truth(value)


def both(left: Function, right: Function, place: Place) -> Function:
    """`and`; the right side is worked out only if the left holds (a guess)."""
    return placed(lambda f: truth(left(f)) and truth(right(f)), place)


def either(left: Function, right: Function, place: Place) -> Function:
    """`or`; the right side is worked out only if the left does not hold (a guess)."""
    return placed(lambda f: truth(left(f)) or truth(right(f)), place)


def inverted(operand: Function, place: Place) -> Function:
    """`not`"""
    return placed(lambda f: not truth(operand(f)), place)


def checked_truth(operand: Function, place: Place) -> Function:
    """A truth value, or an error."""
    return placed(lambda f: truth(operand(f)), place)


def signed(sign: str, operand: Function, place: Place) -> Function:
    """`-a`, `+a`"""
    factor = -1 if sign == "-" else 1
    return placed(lambda f: values.signed(factor, operand(f), f[THREAD].machine.charge), place)


def operation(sign: str, left: Function, right: Function, place: Place) -> Function:
    """Arithmetic, comparison, or `xor`."""
    if sign in _ARITHMETIC:
        slow = _placed_pair(_ARITHMETIC[sign], place)
        return _FAST[sign](left, right, slow) if sign in _FAST else _plain(left, right, slow)
    if sign in ("==", "!="):
        return _equality(left, right, sign == "==")
    if sign == "xor":
        return placed(lambda f: truth(left(f)) is not truth(right(f)), place)
    return _comparison(sign, left, right, place)


Pair = Callable[[Any, Any, Frame], Any]
_ARITHMETIC: dict[str, Callable[[Any, Any, values.Charge], Any]] = {
    "+": values.add,
    "-": values.subtract,
    "*": values.multiply,
    "/": values.divide,
    "%": values.modulo,
}


def _placed_pair(function: Callable[[Any, Any, values.Charge], Any], place: Place) -> Pair:
    """An operation on two values whose faults say where they happened."""
    line, column = place

    def run(a: Any, b: Any, f: Frame) -> Any:
        try:
            return function(a, b, f[THREAD].machine.charge)
        except Fault as fault:
            raise ScriptError(line, column, str(fault)) from None

    return run


def _plain(left: Function, right: Function, slow: Pair) -> Function:
    return lambda f: slow(left(f), right(f), f)


# A result between the two limits is a good integer and a good float alike; the comparison is false for NaN. Whatever
# is not between them is looked at by the slow way.


def _sum(left: Function, right: Function, slow: Pair) -> Function:
    def run(f: Frame) -> Any:
        a, b = left(f), right(f)
        if a.__class__ in NUMBERS and b.__class__ in NUMBERS:
            c = a + b
            if MIN_INTEGER <= c <= MAX_INTEGER:
                return c
        return slow(a, b, f)

    return run


def _difference(left: Function, right: Function, slow: Pair) -> Function:
    def run(f: Frame) -> Any:
        a, b = left(f), right(f)
        if a.__class__ in NUMBERS and b.__class__ in NUMBERS:
            c = a - b
            if MIN_INTEGER <= c <= MAX_INTEGER:
                return c
        return slow(a, b, f)

    return run


def _product(left: Function, right: Function, slow: Pair) -> Function:
    def run(f: Frame) -> Any:
        a, b = left(f), right(f)
        if a.__class__ in NUMBERS and b.__class__ in NUMBERS:
            c = a * b
            if MIN_INTEGER <= c <= MAX_INTEGER:
                return c
        return slow(a, b, f)

    return run


def _quotient(left: Function, right: Function, slow: Pair) -> Function:
    def run(f: Frame) -> Any:
        a, b = left(f), right(f)
        if a.__class__ in NUMBERS and b.__class__ in NUMBERS and b:
            c = a / b
            if MIN_INTEGER <= c <= MAX_INTEGER:
                return c
        return slow(a, b, f)

    return run


_FAST = {"+": _sum, "-": _difference, "*": _product, "/": _quotient}


def _equality(left: Function, right: Function, is_equal: bool) -> Function:
    def run(f: Frame) -> Any:
        a, b = left(f), right(f)
        if a.__class__ in NUMBERS and b.__class__ in NUMBERS:
            return (a == b) is is_equal
        return values.equal(a, b, f[THREAD].machine.charge) is is_equal

    return run


def _comparison(sign: str, left: Function, right: Function, place: Place) -> Function:
    line, column = place

    def slow(a: Any, b: Any) -> bool:
        try:
            return values.compare(sign, a, b)
        except Fault as fault:
            raise ScriptError(line, column, str(fault)) from None

    def less(f: Frame) -> Any:
        a, b = left(f), right(f)
        return a < b if a.__class__ in NUMBERS and b.__class__ in NUMBERS else slow(a, b)

    def at_most(f: Frame) -> Any:
        a, b = left(f), right(f)
        return a <= b if a.__class__ in NUMBERS and b.__class__ in NUMBERS else slow(a, b)

    def greater(f: Frame) -> Any:
        a, b = left(f), right(f)
        return a > b if a.__class__ in NUMBERS and b.__class__ in NUMBERS else slow(a, b)

    def at_least(f: Frame) -> Any:
        a, b = left(f), right(f)
        return a >= b if a.__class__ in NUMBERS and b.__class__ in NUMBERS else slow(a, b)

    return {"<": less, "<=": at_most, ">": greater, ">=": at_least}[sign]


def call(function: Callable[..., Any], arguments: Sequence[Function], place: Place) -> Function:
    """A built-in function that takes no time."""
    line, column = place

    def run(f: Frame) -> Any:
        try:
            return function(f[THREAD], *[argument(f) for argument in arguments])
        except Fault as fault:
            text = str(fault)
        except (ArithmeticError, ValueError) as error:
            text = str(error)
        raise ScriptError(line, column, text)

    return run

"""Functions that make a Python function for each kind of expression.

Such a Python function is called with the frame, and returns the value of the expression. It handles the common cases
itself, which are numbers in variables. `values` handles all other cases.

Many functions store their operands as default values of parameters rather than as closure variables. This is faster,
and makes two objects per function instead of five. The difference matters because a long program has hundreds of
thousands of such functions, and each garbage collection visits all objects.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from operator import itemgetter
from typing import Any

from . import values
from .errors import MAX_INTEGER, MIN_INTEGER, Fault, type_error
from .machine import GLOBALS, THREAD, Frame
from .matrices import is_matrix, on_matrices
from .values import NUMBERS, UNSET, PoseValue, truth

Function = Callable[[Frame], Any]


def _at(place: int, fault: Fault) -> Fault:
    """Set the place of a fault unless the fault already has one, and return the fault."""
    return fault if fault.place is not None else Fault(str(fault), place)


def placed(function: Function, place: int) -> Function:
    """Return a function that does the same, but adds a place to faults that have none."""

    def run(f: Frame) -> Any:
        try:
            return function(f)
        except Fault as fault:
            raise _at(place, fault) from None

    return run


def failing(text: str) -> Function:
    """Make a function that raises a run-time error."""

    def run(f: Frame) -> Any:
        raise Fault(text)

    return run


def constant(value: Any) -> Function:
    """Make a function that returns a constant."""

    def run(f: Frame, value: Any = value) -> Any:
        return value

    return run


def temporary(slot: int) -> Function:
    """Make a function that returns the value that an earlier instruction stored in a slot."""
    return itemgetter(slot)


def local_variable(slot: int, name: str, place: int) -> Function:
    """Make a function that returns a local variable."""

    def run(f: Frame, slot: int = slot, name: str = name, place: int = place) -> Any:
        value = f[slot]
        if value is UNSET:
            raise Fault(f"The variable '{name}' has no value", place)
        return value

    return run


def global_variable(slot: int, name: str, place: int) -> Function:
    """Make a function that returns a global variable."""

    def run(f: Frame, slot: int = slot, name: str = name, place: int = place) -> Any:
        value = f[GLOBALS][slot]
        if value is UNSET:
            raise Fault(f"The variable '{name}' has no value", place)
        return value

    return run


def display(items: Sequence[Function], place: int) -> Function:
    """Make a function that returns a list of these values."""

    def run(f: Frame, items: Sequence[Function] = items) -> Any:
        return values.list_of([item(f) for item in items], f[THREAD].machine.charge)

    return placed(run, place)


def pose_display(items: Sequence[Function], place: int) -> Function:
    """Make a function that returns a pose of these values."""

    def run(f: Frame) -> Any:
        made = [item(f) for item in items]
        for number in made:
            if number.__class__ not in NUMBERS:
                raise type_error(f"a pose cannot contain a value of type {values.type_name(number)}")
        return PoseValue(made)

    return placed(run, place)


def _element(value: Any, at: Any, place: int) -> Any:
    try:
        return values.element(value, at)
    except Fault as fault:
        raise _at(place, fault) from None


def _element_of_variable(value: Any, at: int, name: str, variable: int, place: int) -> Any:
    if value is UNSET:
        raise Fault(f"The variable '{name}' has no value", variable)
    return _element(value, at, place)


def element(base: Function, index: Function, place: int) -> Function:
    """Make a function for `base[index]`."""

    def run(f: Frame, base: Function = base, index: Function = index, place: int = place) -> Any:
        value, at = base(f), index(f)
        if at.__class__ is int and at >= 0 and (value.__class__ is tuple or value.__class__ is PoseValue):
            try:
                return value[at]
            except IndexError:
                pass
        return _element(value, at, place)

    return run


def local_element(slot: int, at: int, name: str, variable: int, place: int) -> Function:
    """Make a function for `name[at]`, an element of a local variable; `variable` is the place of the name."""

    def run(
        f: Frame, slot: int = slot, at: int = at, name: str = name, variable: int = variable, place: int = place
    ) -> Any:
        value = f[slot]
        if value.__class__ is tuple:
            try:
                return value[at]
            except IndexError:
                pass
        return _element_of_variable(value, at, name, variable, place)

    return run


def global_element(slot: int, at: int, name: str, variable: int, place: int) -> Function:
    """Make a function for `name[at]`, an element of a global variable; `variable` is the place of the name."""

    def run(
        f: Frame, slot: int = slot, at: int = at, name: str = name, variable: int = variable, place: int = place
    ) -> Any:
        value = f[GLOBALS][slot]
        if value.__class__ is tuple:
            try:
                return value[at]
            except IndexError:
                pass
        return _element_of_variable(value, at, name, variable, place)

    return run


def structure(names: Sequence[str], items: Sequence[Function], place: int) -> Function:
    """Make a function that returns a struct; the members have these names and values."""

    def run(f: Frame) -> Any:
        made = dict(zip(names, [item(f) for item in items], strict=True))
        return values.struct_of(made, f[THREAD].machine.charge)

    return placed(run, place)


def member(base: Function, name: str, place: int) -> Function:
    """Make a function for `base.name`."""
    return placed(lambda f: values.member(base(f), name), place)


def both(left: Function, right: Function, place: int) -> Function:
    """Make a function for `and`. It evaluates the right operand only if the left operand is true (assumed)."""
    return placed(lambda f: truth(left(f)) and truth(right(f)), place)


def either(left: Function, right: Function, place: int) -> Function:
    """Make a function for `or`. It evaluates the right operand only if the left operand is false (assumed)."""
    return placed(lambda f: truth(left(f)) or truth(right(f)), place)


def inverted(operand: Function, place: int) -> Function:
    """Make a function for `not`."""
    return placed(lambda f: not truth(operand(f)), place)


def checked_truth(operand: Function, place: int) -> Function:
    """Make a function that returns the truth value of the operand."""
    return placed(lambda f: truth(operand(f)), place)


def signed(sign: str, operand: Function, place: int) -> Function:
    """Make a function for `-a` or `+a`."""
    factor = -1 if sign == "-" else 1

    def run(f: Frame) -> Any:
        value = operand(f)
        if value.__class__ is tuple:
            return _slow(values.multiply, value, factor, f, place)
        return values.signed(factor, value)

    return placed(run, place)


def operation(sign: str, left: Function, right: Function, place: int) -> Function:
    """Make a function for an arithmetic operation, a comparison, or `xor`."""
    return _OPERATIONS[sign](left, right, place)


# A result within the limits is valid, both as an integer and as a float. The comparison is false for NaN. `_slow`
# handles results outside the limits.


def _slow(function: Callable[[Any, Any, values.Charge], Any], a: Any, b: Any, f: Frame, place: int) -> Any:
    machine = f[THREAD].machine
    try:
        if machine.has_matrices and (is_matrix(a) or is_matrix(b)):
            return on_matrices(function, a, b, machine.charge)
        return function(a, b, machine.charge)
    except Fault as fault:
        raise _at(place, fault) from None


def _sum(left: Function, right: Function, place: int) -> Function:
    def run(f: Frame, left: Function = left, right: Function = right, place: int = place) -> Any:
        a, b = left(f), right(f)
        if a.__class__ in NUMBERS and b.__class__ in NUMBERS:
            c = a + b
            if MIN_INTEGER <= c <= MAX_INTEGER:
                return c
        return _slow(values.add, a, b, f, place)

    return run


def _difference(left: Function, right: Function, place: int) -> Function:
    def run(f: Frame, left: Function = left, right: Function = right, place: int = place) -> Any:
        a, b = left(f), right(f)
        if a.__class__ in NUMBERS and b.__class__ in NUMBERS:
            c = a - b
            if MIN_INTEGER <= c <= MAX_INTEGER:
                return c
        return _slow(values.subtract, a, b, f, place)

    return run


def _product(left: Function, right: Function, place: int) -> Function:
    def run(f: Frame, left: Function = left, right: Function = right, place: int = place) -> Any:
        a, b = left(f), right(f)
        if a.__class__ in NUMBERS and b.__class__ in NUMBERS:
            c = a * b
            if MIN_INTEGER <= c <= MAX_INTEGER:
                return c
        return _slow(values.multiply, a, b, f, place)

    return run


def _quotient(left: Function, right: Function, place: int) -> Function:
    def run(f: Frame, left: Function = left, right: Function = right, place: int = place) -> Any:
        a, b = left(f), right(f)
        if a.__class__ in NUMBERS and b.__class__ in NUMBERS and b:
            c = a / b
            if MIN_INTEGER <= c <= MAX_INTEGER:
                return c
        return _slow(values.divide, a, b, f, place)

    return run


def _remainder(left: Function, right: Function, place: int) -> Function:
    return lambda f: _slow(values.modulo, left(f), right(f), f, place)


def _exclusive(left: Function, right: Function, place: int) -> Function:
    return placed(lambda f: truth(left(f)) is not truth(right(f)), place)


def _equal(left: Function, right: Function, place: int) -> Function:
    def run(f: Frame, left: Function = left, right: Function = right) -> Any:
        a, b = left(f), right(f)
        if a.__class__ in NUMBERS and b.__class__ in NUMBERS:
            return a == b
        return values.equal(a, b, f[THREAD].machine.charge)

    return run


def _unequal(left: Function, right: Function, place: int) -> Function:
    equal = _equal(left, right, place)
    return lambda f: not equal(f)


def _slow_comparison(sign: str, a: Any, b: Any, place: int) -> bool:
    try:
        return values.compare(sign, a, b)
    except Fault as fault:
        raise _at(place, fault) from None


def _less(left: Function, right: Function, place: int) -> Function:
    def run(f: Frame, left: Function = left, right: Function = right, place: int = place) -> Any:
        a, b = left(f), right(f)
        return a < b if a.__class__ in NUMBERS and b.__class__ in NUMBERS else _slow_comparison("<", a, b, place)

    return run


def _at_most(left: Function, right: Function, place: int) -> Function:
    def run(f: Frame, left: Function = left, right: Function = right, place: int = place) -> Any:
        a, b = left(f), right(f)
        return a <= b if a.__class__ in NUMBERS and b.__class__ in NUMBERS else _slow_comparison("<=", a, b, place)

    return run


def _greater(left: Function, right: Function, place: int) -> Function:
    def run(f: Frame, left: Function = left, right: Function = right, place: int = place) -> Any:
        a, b = left(f), right(f)
        return a > b if a.__class__ in NUMBERS and b.__class__ in NUMBERS else _slow_comparison(">", a, b, place)

    return run


def _at_least(left: Function, right: Function, place: int) -> Function:
    def run(f: Frame, left: Function = left, right: Function = right, place: int = place) -> Any:
        a, b = left(f), right(f)
        return a >= b if a.__class__ in NUMBERS and b.__class__ in NUMBERS else _slow_comparison(">=", a, b, place)

    return run


_OPERATIONS: dict[str, Callable[[Function, Function, int], Function]] = {
    "+": _sum,
    "-": _difference,
    "*": _product,
    "/": _quotient,
    "%": _remainder,
    "==": _equal,
    "!=": _unequal,
    "<": _less,
    "<=": _at_most,
    ">": _greater,
    ">=": _at_least,
    "xor": _exclusive,
}


# This is the most common case: the right operand is a constant number.


def _sum_with(left: Function, b: float, place: int) -> Function:
    def run(f: Frame, left: Function = left, b: float = b, place: int = place) -> Any:
        a = left(f)
        if a.__class__ in NUMBERS:
            c = a + b
            if MIN_INTEGER <= c <= MAX_INTEGER:
                return c
        return _slow(values.add, a, b, f, place)

    return run


def _product_by(left: Function, b: float, place: int) -> Function:
    def run(f: Frame, left: Function = left, b: float = b, place: int = place) -> Any:
        a = left(f)
        if a.__class__ in NUMBERS:
            c = a * b
            if MIN_INTEGER <= c <= MAX_INTEGER:
                return c
        return _slow(values.multiply, a, b, f, place)

    return run


def _quotient_by(left: Function, b: float, place: int) -> Function:
    def run(f: Frame, left: Function = left, b: float = b, place: int = place) -> Any:
        a = left(f)
        if a.__class__ in NUMBERS and b:
            c = a / b
            if MIN_INTEGER <= c <= MAX_INTEGER:
                return c
        return _slow(values.divide, a, b, f, place)

    return run


def _equal_to(left: Function, b: float, place: int) -> Function:
    def run(f: Frame, left: Function = left, b: float = b) -> Any:
        a = left(f)
        return a == b if a.__class__ in NUMBERS else values.equal(a, b, f[THREAD].machine.charge)

    return run


def _less_than(left: Function, b: float, place: int) -> Function:
    def run(f: Frame, left: Function = left, b: float = b, place: int = place) -> Any:
        a = left(f)
        return a < b if a.__class__ in NUMBERS else _slow_comparison("<", a, b, place)

    return run


_OPERATIONS_BY: dict[str, Callable[[Function, float, int], Function]] = {
    "+": _sum_with,
    "*": _product_by,
    "/": _quotient_by,
    "==": _equal_to,
    "<": _less_than,
}


def operation_by(sign: str, left: Function, right: float, place: int) -> Function:
    """Make a function like `operation` does, but with a constant number as right operand."""
    by = _OPERATIONS_BY.get(sign)
    return operation(sign, left, constant(right), place) if by is None else by(left, right, place)


def choice(condition: Function, then: Function, otherwise: Function, place: int) -> Function:
    """Make a function that returns one of two values, depending on a condition at `place`."""

    def run(f: Frame, condition: Function = condition, then: Function = then, otherwise: Function = otherwise) -> Any:
        value = condition(f)
        if value is True:
            return then(f)
        if value is False:
            return otherwise(f)
        try:
            holds = truth(value)
        except Fault as fault:
            raise _at(place, fault) from None
        return then(f) if holds else otherwise(f)

    return run


def leaf_call(function: Function, arguments: Sequence[Function]) -> Function:
    """Make a function that calls a leaf function with a frame that contains the arguments."""

    def run(f: Frame, function: Function = function, arguments: Sequence[Function] = arguments) -> Any:
        frame = [f[GLOBALS], f[THREAD]]
        for argument in arguments:
            frame.append(argument(f))
        return function(frame)

    return run


def call(function: Callable[..., Any], arguments: Sequence[Function], place: int) -> Function:
    """Make a function that calls a built-in function that takes no time."""

    def run(
        f: Frame, function: Callable[..., Any] = function, arguments: Sequence[Function] = arguments, place: int = place
    ) -> Any:
        try:
            return function(f[THREAD], *[argument(f) for argument in arguments])
        except Fault as fault:
            raise _at(place, fault) from None
        except (ArithmeticError, ValueError) as error:
            raise Fault(str(error), place) from None

    return run

"""Compiler of expressions to Python functions.

An expression is compiled once and evaluated many times; a condition is evaluated in each cycle. A variable of the
script is looked up by name each time, because the script can make it at any moment. A system variable is looked up
once. There is no short circuit: both sides of ``|`` and ``&`` are always evaluated.
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Mapping

from .arithmetic import (
    BINARY_FUNCTIONS,
    UNARY_FUNCTIONS,
    divide,
    power,
    remainder_inclusive,
    remainder_modulo,
    truncate,
)
from .profile import Profile
from .symbols import Symbol, Symbols
from .syntax import ArrayElement, Call, Expression, Negate, NumberLiteral, VariableName

#: A compiled expression.
Value = Callable[[], float]

#: Value that MRC reads beyond an array: the address of the array's name as a double. It is printed as 0, and is true.
BEYOND = 4.6e-310

#: Operators whose result is 0 or 1. Both operands are computed first.
_TRUTHS: Mapping[str, Callable[[float, float], bool]] = {
    "|": lambda left, right: left != 0.0 or right != 0.0,
    "&": lambda left, right: left != 0.0 and right != 0.0,
    "==": operator.eq,
    "!=": operator.ne,
    ">": operator.gt,
    "<": operator.lt,
    ">=": operator.ge,
    "<=": operator.le,
}
_ARITHMETIC: Mapping[str, Callable[[float, float], float]] = {
    "+": operator.add,
    "-": operator.sub,
    "*": operator.mul,
    "/": divide,
    "^": power,
}


class LineFault(Exception):
    """Error: a line cannot be executed. The fault ends the plan, and is not raised outside of the interpreter.

    Attributes:
        column: Column of the faulty part in the line, counted from 1; 0 for the whole line.
        is_limit: Whether a limit was reached.
    """

    def __init__(self, message: str, column: int = 0, *, is_limit: bool = False) -> None:
        super().__init__(message)
        self.column = column
        self.is_limit = is_limit


class Compiler:
    """Compiler of expressions for one set of variables.

    Args:
        symbols: Variables.
        profile: Profile, which decides about `rem` and about an index beyond an array.
        functions: Additional functions of the user, by name.
    """

    #: Number of counters of `ntrue`.
    COUNTERS = 10

    def __init__(self, symbols: Symbols, profile: Profile, functions: Mapping[str, Callable[..., float]]) -> None:
        self._symbols = symbols
        self._profile = profile
        self._counters = [0] * self.COUNTERS
        self._functions: dict[str, Callable[..., float]] = {
            **UNARY_FUNCTIONS,
            **BINARY_FUNCTIONS,
            "rem": remainder_modulo if profile.rem_excludes_divisor else remainder_inclusive,
            "ntrue": self._count_true,
        }
        self._user_functions = functions

    def reset_counter(self, number: int) -> bool:
        """Set a counter of `ntrue` to 0. Return False if there is no such counter."""
        if not 0 <= number < self.COUNTERS:
            return False
        self._counters[number] = 0
        return True

    def find(self, variable: VariableName) -> Symbol:
        """Find the symbol of a variable.

        Raises:
            LineFault: If there is no such variable.
        """
        if variable.is_system:
            symbol = self._symbols.find_system(variable.name)
            if symbol is None:
                raise LineFault(f"the robot has no system variable ${variable.name}", variable.column)
            return symbol
        found = self._symbols.user.get(variable.name)
        if found is None:
            raise LineFault(f"there is no variable {variable.name}; assign a value to it first", variable.column)
        return found

    def compile(self, expression: Expression) -> Value:
        """Compile to a function that evaluates the expression, or raises `LineFault` if it cannot."""
        if isinstance(expression, NumberLiteral):
            value = expression.value
            return lambda: value
        if isinstance(expression, VariableName):
            return self._variable(expression)
        if isinstance(expression, ArrayElement):
            return self._element(expression)
        if isinstance(expression, Call):
            return self._call(expression)
        if isinstance(expression, Negate):
            operand = self.compile(expression.operand)
            return lambda: -operand()
        left, right = self.compile(expression.left), self.compile(expression.right)
        is_true = _TRUTHS.get(expression.operator)
        if is_true is not None:
            return lambda: 1.0 if is_true(left(), right()) else 0.0
        calculate = _ARITHMETIC[expression.operator]
        return lambda: calculate(left(), right())

    def _variable(self, variable: VariableName) -> Value:
        pool = self._symbols.pool
        if variable.is_system and (symbol := self._symbols.find_system(variable.name)) is not None:
            place = symbol.place
            return lambda: pool[place]
        return lambda: pool[self.find(variable).place]

    def _element(self, element: ArrayElement) -> Value:
        pool = self._symbols.pool
        index = self.compile(element.index)

        def value() -> float:
            symbol = self.find(element.array)
            place = truncate(index())
            if 0 <= place < symbol.size:
                return pool[symbol.place + place]
            if self._profile.indices_are_checked:
                raise self.beyond(element.array, symbol, place)
            return BEYOND

        return value

    @staticmethod
    def beyond(array: VariableName, symbol: Symbol, index: int) -> LineFault:
        """Create the fault for an index beyond an array."""
        name = f"${array.name}" if array.is_system else array.name
        what = f"values {name}[0] to {name}[{symbol.size - 1}]" if symbol.size > 1 else "one value"
        return LineFault(f"index {index} is beyond {name}, which has {what}", array.column)

    def _call(self, call: Call) -> Value:
        function = self._guarded(call) if call.name in self._user_functions else self._functions[call.name]
        arguments = [self.compile(each) for each in call.arguments]
        if len(arguments) == 1:
            only = arguments[0]
            return lambda: function(only())
        if len(arguments) == 2:
            first, second = arguments
            return lambda: function(first(), second())
        return lambda: function(*[each() for each in arguments])

    def _guarded(self, call: Call) -> Callable[..., float]:
        """Wrap a function of the user, which might raise any exception."""
        function = self._user_functions[call.name]

        def guarded(*arguments: float) -> float:
            try:
                return float(function(*arguments))
            except Exception as error:
                raise LineFault(f"{call.name}() raised {type(error).__name__}: {error}", call.column) from error

        return guarded

    def _count_true(self, number: float, condition: float) -> float:
        if not 0 <= number <= self.COUNTERS - 1:
            return -1.0
        counter = int(number)
        if condition != 0.0:
            self._counters[counter] += 1
        return float(self._counters[counter])

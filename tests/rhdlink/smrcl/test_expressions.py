"""Expressions compared with Python's operators and the functions of C, with the rules of MRC.

The text of a random tree is parsed and evaluated. The expected value is computed from the tree with numpy's doubles,
which divide by zero as C does, and with the functions of the C library.
"""

from __future__ import annotations

import ctypes
import ctypes.util
import math
from collections.abc import Callable
from functools import cache

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rhdlink.smrcl.commands import COMMANDS
from rhdlink.smrcl.expressions import Compiler
from rhdlink.smrcl.parser import Parser
from rhdlink.smrcl.profile import MRC, SOUND, Profile
from rhdlink.smrcl.symbols import Symbols
from rhdlink.smrcl.syntax import (
    PRECEDENCE,
    ArrayElement,
    Binary,
    Call,
    Evaluate,
    Expression,
    Negate,
    NumberLiteral,
    VariableName,
)
from tests import platforms
from tests.rhdlink.smrcl.written import write_expression

LIBRARY = ctypes.util.find_library("m")
pytestmark = pytest.mark.skipif(LIBRARY is None, reason=platforms.MACHINE)

PARSER = Parser(COMMANDS)
#: Variables of the script and their values.
VALUES = {"a": 0.0, "b": -2.5, "c": math.inf, "d": math.nan, "e": 1e-3}
ARRAY = [4.0, -1.0, 0.5]
#: Names of functions in SMR-CL, and their names in C.
OF_C = {
    **{name: name for name in ("sin", "cos", "asin", "acos", "tan", "atan", "exp", "sqrt", "atan2")},
    "ln": "log",
    "abs": "fabs",
}


@cache
def of_c(name: str) -> Callable[..., float]:
    assert LIBRARY is not None
    function = getattr(ctypes.CDLL(LIBRARY), name)
    function.restype = ctypes.c_double

    def call(*arguments: float) -> float:
        return float(function(*map(ctypes.c_double, arguments)))

    return call


def truth(value: bool | np.bool_) -> np.float64:
    return np.float64(1.0 if value else 0.0)


def computed(tree: Expression) -> np.float64:
    """Return the expected value of a tree."""
    if isinstance(tree, NumberLiteral):
        return np.float64(tree.value)
    if isinstance(tree, VariableName):
        return np.float64(VALUES[tree.name])
    if isinstance(tree, ArrayElement):
        return np.float64(ARRAY[int(computed(tree.index))])
    if isinstance(tree, Negate):
        return np.float64(-computed(tree.operand))
    if isinstance(tree, Call) and tree.name == "hypot":
        # Python's hypot is more exact: for six of a thousand pairs, the result of C differs in the last bit.
        return np.float64(math.hypot(*map(computed, tree.arguments)))
    if isinstance(tree, Call):
        return np.float64(of_c(OF_C[tree.name])(*map(computed, tree.arguments)))
    left, right = computed(tree.left), computed(tree.right)  # both sides are always evaluated
    if tree.operator == "^":
        return np.float64(of_c("pow")(left, right))
    results: dict[str, Callable[[], np.float64]] = {
        "|": lambda: truth((left != 0) or (right != 0)),
        "&": lambda: truth((left != 0) and (right != 0)),
        "==": lambda: truth(left == right),
        "!=": lambda: truth(left != right),
        ">": lambda: truth(left > right),
        "<": lambda: truth(left < right),
        ">=": lambda: truth(left >= right),
        "<=": lambda: truth(left <= right),
        "+": lambda: left + right,
        "-": lambda: left - right,
        "*": lambda: left * right,
        "/": lambda: left / right,
    }
    return results[tree.operator]()


numbers = st.builds(NumberLiteral, st.one_of(st.sampled_from([0.0, 0.5, 1.0, 2.0, 3.0, 1e300]), st.floats(0.0, 1e3)))
elements = st.builds(ArrayElement, st.just(VariableName("q")), st.builds(NumberLiteral, st.floats(0.0, 2.99)))
leaves = st.one_of(numbers, st.builds(VariableName, st.sampled_from(sorted(VALUES))), elements)


def _compound(inner: st.SearchStrategy[Expression]) -> st.SearchStrategy[Expression]:
    calls = st.sampled_from(sorted(OF_C)).flatmap(
        lambda name: st.builds(Call, st.just(name), st.tuples(*[inner] * (2 if name in ("atan2", "hypot") else 1)))
    )
    binary = st.builds(Binary, st.sampled_from(sorted(PRECEDENCE)), inner, inner)
    return st.one_of(binary, binary, st.builds(Negate, inner), calls)


@pytest.mark.property
@pytest.mark.parametrize("profile", [MRC, SOUND], ids=lambda profile: profile.name)
@given(tree=st.recursive(leaves, _compound, max_leaves=12))
def test_expression_evaluates_as_in_c_language(profile: Profile, tree: Expression) -> None:
    symbols = Symbols((), {}, {})
    for name, value in VALUES.items():
        made = symbols.make(name)
        assert made is not None
        symbols.pool[made.place] = value
    array = symbols.make_array("q", len(ARRAY))
    assert array is not None
    symbols.pool[array.place : array.place + len(ARRAY)] = ARRAY
    line = PARSER.parse(f"eval {write_expression(tree)}")
    (statement,) = line.statements
    assert isinstance(statement, Evaluate)
    found = Compiler(symbols, profile, {}).compile(statement.values[0])()
    with np.errstate(all="ignore"):
        expected = float(computed(tree))
    assert found == expected or (math.isnan(found) and math.isnan(expected))

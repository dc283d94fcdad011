"""Arithmetic of matrices. A matrix is a list of rows, and a row is a list of numbers. All rows have the same length.

The script manual describes this arithmetic for firmware 3.14, 5.9 and later. A matrix can be multiplied by a number, a
list or a matrix. Matrices of equal size can be added and subtracted. `transpose` and `inv` transpose and invert a
matrix. Two facts are assumed. If a number is added to a matrix, it is added to each element, as for a list. A list to
the left of a matrix is a row.
"""

from __future__ import annotations

import operator
from collections.abc import Callable
from functools import reduce
from typing import Any

from linkcore.wire.fields import Since

from .errors import MAX_ELEMENTS, Fault, type_error
from .values import NUMBERS, Charge, add, checked, divide, modulo, multiply, subtract, type_name

#: First firmware releases that support arithmetic with matrices.
HAS_MATRICES = Since("3.14/5.9")

Matrix = tuple[tuple[Any, ...], ...]


def is_matrix(value: Any) -> bool:
    """Whether `value` is a list whose first element is a list."""
    return value.__class__ is tuple and bool(value) and value[0].__class__ is tuple


def rows_of(value: Any, charge: Charge) -> Matrix:
    """Check that the rows contain only numbers and have the same length, and return them."""
    if not is_matrix(value):
        raise type_error(f"the value has the type {type_name(value)}; expected a matrix")
    columns = len(value[0])
    charge(len(value) * columns)
    for row in value:
        if row.__class__ is not tuple or not NUMBERS.issuperset(map(type, row)):
            raise type_error("a matrix must be a list of lists of numbers")
        if len(row) != columns or not columns:
            raise Fault("the rows of a matrix must have the same length")
    return value  # type: ignore[no-any-return]


def transposed(value: Any, charge: Charge) -> Matrix:
    """Return the matrix with rows and columns exchanged."""
    return tuple(zip(*rows_of(value, charge), strict=True))


def on_matrices(function: Callable[[Any, Any, Charge], Any], a: Any, b: Any, charge: Charge) -> Any:
    """Apply an operator of `values` to two operands. At least one operand is a matrix."""
    if function is multiply and a.__class__ is tuple and b.__class__ is tuple:
        return _product(a, b, charge)
    left = rows_of(a, charge) if a.__class__ is tuple else None
    right = rows_of(b, charge) if b.__class__ is tuple else None
    if right is None:
        return tuple([function(row, b, charge) for row in left or ()])
    if left is None:
        if function in (divide, modulo):
            raise type_error(f"{type_name(a)} {_SIGNS[function]} matrix")
        return tuple([function(a, row, charge) for row in right])
    if function not in (add, subtract):
        raise type_error(f"matrix {_SIGNS[function]} matrix")
    if _size(left) != _size(right):
        raise Fault(f"Matrix sizes differ: {_size(left)} {_SIGNS[function]} {_size(right)}")
    return tuple([function(x, y, charge) for x, y in zip(left, right, strict=True)])


_SIGNS: dict[Any, str] = {add: "+", subtract: "-", multiply: "*", divide: "/", modulo: "%"}


def _size(matrix: Matrix) -> str:
    return f"{len(matrix)}x{len(matrix[0])}"


def _product(a: Any, b: Any, charge: Charge) -> Any:
    """Return the product of two matrices, or of a matrix and a list.

    The product of a matrix and a list is a list. A list to the right of the matrix is a column, and a list to the left
    is a row.
    """
    left = rows_of(a if is_matrix(a) else (a,), charge)
    right = rows_of(b, charge) if is_matrix(b) else transposed((b,), charge)
    if len(left[0]) != len(right):
        raise Fault(f"Matrix sizes differ: {_size(left)} * {_size(right)}")
    elements = len(left) * len(right[0])
    if elements > MAX_ELEMENTS:
        raise Fault(f"List too long: {elements} elements")
    charge(elements * len(right))
    columns = list(zip(*right, strict=True))
    # Do not use `sum`, which rounds differently since Python 3.12.
    made = tuple(
        [
            tuple([checked(reduce(operator.add, map(operator.mul, row, column), 0)) for column in columns])
            for row in left
        ]
    )
    if not is_matrix(a):
        return made[0]
    return made if is_matrix(b) else tuple([row[0] for row in made])

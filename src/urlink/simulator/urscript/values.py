"""Values of variables, and the operators for these values.

A value is a Python number, a truth value, a string, a tuple (for a list), a `PoseValue`, a `Struct`, or a handle. All
values are immutable, so a value can be passed without a copy. An assignment to an element makes a new list.

Three facts are known. A number can be a condition, which is true unless the number is zero: the program of a driver
contains `if has_qnear:`, and the variable is a quotient. A log of 5.x shows that numbers are printed with six digits,
like `%g` in C, and that there are no spaces between the elements of a list or pose. The tests of a public project show
that firmware 5.9 to 5.14 refuses to assign a list of another length to a variable ("Resizing of 'List' is not
supported"); the simulator does not check this. The following is assumed:

- The result of `/` is always a float and is not truncated. Drivers divide integers from a socket by a million and use
  the fraction.
- The result of `%` has the sign of the left operand, as in C.
- An integer result that exceeds 32 bits is an error. A result that is not finite is an error too.
- Truth values are not numbers.
- Values of different types are not equal, but an integer and a float are equal if their numbers are equal.
- Arithmetic with lists works element by element, even if one operand is a number. Arithmetic with poses is not
  supported. For lists of lists, see `matrices`.
- An assignment copies a struct, as it copies a list. No members can be added to a struct.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

from .errors import MAX_ELEMENTS, MAX_INTEGER, MAX_STRUCTS, MIN_INTEGER, Fault, type_error

NUMBERS: frozenset[Any] = frozenset({int, float})
#: Function that is called with the number of elements that were made.
Charge = Callable[[int], None]
#: Maximum number of characters in the name of a remote method before its last part.
_LONGEST_PREFIX = 255


class PoseValue(tuple[float, ...]):
    """Pose of six numbers: x, y, z in m and a rotation vector in rad."""

    __slots__ = ()


class Struct:
    """Immutable struct with named members, made by `struct(a=1, b=2)`.

    Attributes:
        members: Name -> value.
        weight: Number of elements and characters in the struct.
        depth: Nesting depth of structs.
    """

    __slots__ = ("depth", "members", "weight")

    def __init__(self, members: Mapping[str, Any]) -> None:
        self.members = members
        self.weight = len(members) + sum(map(weight, members.values()))
        self.depth: int = 1 + max((value.depth for value in members.values() if isinstance(value, Struct)), default=0)


class RpcHandle:
    """Result of `rpc_factory`: handle for the methods of an XML-RPC server.

    `handle.server` is a handle for the same server with the prefix "server.", so `handle.server.f(x)` calls the method
    "server.f".
    """

    __slots__ = ("host", "path", "port", "prefix", "url")

    def __init__(self, url: str, host: str, port: int, path: str, prefix: str = "") -> None:
        self.url = url
        self.host = host
        self.port = port
        self.path = path
        self.prefix = prefix

    def within(self, name: str) -> RpcHandle:
        """Return a handle with `name.` added to the prefix of method names."""
        prefix = f"{self.prefix}{name}."
        if len(prefix) > _LONGEST_PREFIX:
            raise Fault(f"the name of a remote method is longer than {_LONGEST_PREFIX} characters")
        return RpcHandle(self.url, self.host, self.port, self.path, prefix)


class MemberName(str):
    """Name of a struct member in the indices of an assignment.

    The special type is needed because a plain string is not a valid index.
    """

    __slots__ = ()


class Unset:
    """Value of a variable before its first assignment."""


UNSET = Unset()

#: Classes of values that contain elements or characters.
_HEAVY: frozenset[Any] = frozenset({tuple, PoseValue, str, Struct})

_NAMES = {
    bool: "bool",
    int: "int",
    float: "float",
    str: "string",
    tuple: "list",
    PoseValue: "pose",
    Struct: "struct",
    RpcHandle: "handle of a server",
    type(None): "none",
}


def type_name(value: object) -> str:
    """Return the name of the type of a value, for error messages."""
    return _NAMES.get(type(value), "thread handle")


def to_str(value: object) -> str:
    """Return the text of a value, as `textmsg` and `to_str` show it."""
    if isinstance(value, (str, int)):
        return str(value)
    if isinstance(value, float):
        return f"{value:g}"
    if isinstance(value, tuple):
        return f"{'p' if isinstance(value, PoseValue) else ''}[{','.join(map(to_str, value))}]"
    if isinstance(value, Struct):
        return f"struct({','.join(f'{name}={to_str(member)}' for name, member in value.members.items())})"
    return type_name(value)


def weight(value: Any) -> int:
    """Return the number of elements and characters in a value, including inner lists."""
    if value.__class__ is str:
        return len(value)
    if value.__class__ is tuple:
        total = len(value)
        for inner in value:
            if inner.__class__ in _HEAVY:
                total += weight(inner)
        return total
    if isinstance(value, Struct):
        return value.weight
    return 6 if value.__class__ is PoseValue else 0


def list_of(items: Sequence[Any], charge: Charge) -> tuple[Any, ...]:
    """Return a list of at most `MAX_ELEMENTS` elements, including the elements of inner lists.

    It is assumed that inner lists cannot contain lists.
    """
    made = tuple(items)
    total = len(made)
    for item in made if not NUMBERS.issuperset(map(type, made)) else ():
        if item.__class__ is tuple:
            if any(inner.__class__ is tuple for inner in item):
                raise type_error("lists can be nested only once; the lists in a list cannot contain lists")
            total += weight(item)
        elif item.__class__ in _HEAVY:
            total += weight(item)
        elif item is None:
            raise type_error("a list cannot contain none")
    if total > MAX_ELEMENTS:
        raise Fault(f"List too long: {total} elements")
    charge(total)
    return made


def struct_of(members: Mapping[str, Any], charge: Charge) -> Struct:
    """Return a struct, after checking its size (like that of a list) and its nesting depth (`MAX_STRUCTS`)."""
    if None in members.values():
        raise type_error("a struct cannot contain none")
    made = Struct(members)
    if made.weight > MAX_ELEMENTS:
        raise Fault(f"Struct too large: {made.weight} elements")
    if made.depth > MAX_STRUCTS:
        raise Fault(f"structs are nested too deeply; the limit is {MAX_STRUCTS}")
    charge(made.weight)
    return made


def checked(value: float | int) -> float | int:
    """Return a number; raise a fault if it is not finite, or is an integer that exceeds 32 bits."""
    if isinstance(value, int):
        if not MIN_INTEGER <= value <= MAX_INTEGER:
            raise Fault("Integer overflow")
    elif not math.isfinite(value):
        raise Fault("Floating point overflow, or result is not a number")
    return value


# -- arithmetic --------------------------------------------------------------------------------------


def signed(factor: int, a: Any) -> Any:
    """Return `factor * a` for a number `a`; the factor is -1 or 1."""
    if a.__class__ not in NUMBERS:
        raise type_error(f"{'-' if factor < 0 else '+'} {type_name(a)}")
    return checked(factor * a)


def _remainder(a: Any, b: Any) -> Any:
    rest = math.fmod(a, b)
    return rest if float in (a.__class__, b.__class__) else int(rest)


def _number(function: Callable[[Any, Any], Any], sign: str, a: Any, b: Any) -> Any:
    if a.__class__ not in NUMBERS or b.__class__ not in NUMBERS:
        raise type_error(f"{type_name(a)} {sign} {type_name(b)}")
    if b == 0 and sign in "/%":
        raise Fault("Division by zero")
    try:
        return checked(function(a, b))
    except (ArithmeticError, ValueError):
        raise Fault("Floating point overflow, or result is not a number") from None


def _arithmetic(function: Callable[[Any, Any], Any], sign: str, a: Any, b: Any, charge: Charge) -> Any:
    if a.__class__ is tuple:
        charge(len(a))
        if b.__class__ is tuple:
            if len(a) != len(b):
                raise Fault(f"List lengths differ: {len(a)} {sign} {len(b)}")
            return tuple([_number(function, sign, x, y) for x, y in zip(a, b, strict=True)])
        return tuple([_number(function, sign, x, b) for x in a])
    if b.__class__ is tuple:
        charge(len(b))
        return tuple([_number(function, sign, a, y) for y in b])
    return _number(function, sign, a, b)


#: Operations such as `a + b` on two values. The third argument is a function that counts new elements.
add = partial(_arithmetic, operator.add, "+")
subtract = partial(_arithmetic, operator.sub, "-")
multiply = partial(_arithmetic, operator.mul, "*")
divide = partial(_arithmetic, operator.truediv, "/")
modulo = partial(_arithmetic, _remainder, "%")


# -- comparison --------------------------------------------------------------------------------------


def equal(a: Any, b: Any, charge: Charge) -> bool:
    """Return whether `a == b`."""
    if a.__class__ in NUMBERS and b.__class__ in NUMBERS:
        return bool(a == b)
    if a.__class__ is not b.__class__:
        return False
    if a.__class__ is tuple or a.__class__ is PoseValue:
        if len(a) != len(b):
            return False
        charge(len(a))
        return all(equal(x, y, charge) for x, y in zip(a, b, strict=True))
    if isinstance(a, Struct):
        charge(a.weight)
        return a.members.keys() == b.members.keys() and all(
            equal(member, b.members[name], charge) for name, member in a.members.items()
        )
    if a.__class__ is str:
        charge(len(a) // 16)
    return bool(a == b)


def compare(sign: str, a: Any, b: Any) -> bool:
    """Return the result of `<`, `<=`, `>` or `>=`. Only numbers can be compared."""
    if a.__class__ not in NUMBERS or b.__class__ not in NUMBERS:
        raise type_error(f"{type_name(a)} {sign} {type_name(b)}")
    return bool({"<": operator.lt, "<=": operator.le, ">": operator.gt, ">=": operator.ge}[sign](a, b))


def truth(value: Any) -> bool:
    """Return the truth value of a condition."""
    if value is True or value is False or value.__class__ in NUMBERS:
        return bool(value)
    raise type_error(f"a condition has the type {type_name(value)}; expected a truth value or a number")


# -- elements ----------------------------------------------------------------------------------------


def _place(value: Any, index: Any) -> int:
    if value.__class__ is not tuple and value.__class__ is not PoseValue:
        raise type_error(f"a value of type {type_name(value)} has no elements")
    if index.__class__ is float and index.is_integer():
        index = int(index)
    if index.__class__ is not int:
        raise type_error(f"an index has the type {type_name(index)}; expected an integer")
    if not 0 <= index < len(value):
        raise Fault(f"Index out of range: {index} of {len(value)}")
    return int(index)


def element(value: Any, index: Any) -> Any:
    """Return `value[index]`. A float is a valid index if it is a whole number (assumed)."""
    return value[_place(value, index)]


def member(value: Any, name: str) -> Any:
    """Return `value.name`."""
    if isinstance(value, RpcHandle):
        return value.within(name)
    return _struct_member(value, name)


def _struct_member(value: Any, name: str) -> Any:
    if not isinstance(value, Struct) or name not in value.members:
        raise type_error(f"{type_name(value)} has no member '{name}'")
    return value.members[name]


def replaced(value: Any, indices: Sequence[Any], new: Any, charge: Charge) -> Any:
    """Return a copy of `value` in which the value at the indices is `new`.

    `[i, j]` as indices stand for `value[i][j] = new`. A `MemberName` in the indices selects a member.
    """
    if indices[0].__class__ is MemberName:
        old = _struct_member(value, indices[0])
        changed = new if len(indices) == 1 else replaced(old, indices[1:], new, charge)
        return struct_of({**value.members, indices[0]: changed}, charge)
    index = _place(value, indices[0])
    if len(indices) > 1:
        new = replaced(value[index], indices[1:], new, charge)
    elif value.__class__ is PoseValue and new.__class__ not in NUMBERS:
        raise type_error(f"a pose cannot contain a value of type {type_name(new)}")
    items = list(value)
    items[index] = new
    if value.__class__ is PoseValue:
        return PoseValue(items)
    if new.__class__ in NUMBERS or new.__class__ is bool:
        # The length is the same, so only long lists are counted as work.
        if len(items) > 32:
            charge(len(items) // 32)
        return tuple(items)
    return list_of(items, charge)

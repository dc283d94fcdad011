"""Functions that only compute a value, from numbers, lists and strings."""

from __future__ import annotations

import math
import re
from typing import Any

from ..errors import MAX_ELEMENTS, MAX_STRING, Fault, type_error
from ..machine import ScriptThread
from ..matrices import Matrix, transposed
from ..values import checked, list_of, to_str, type_name
from .declaration import boolean, declare, integer, is_list, number, numbers, string

_NUMBER = re.compile(r"\s*[+-]?(?:[0-9]+(\.[0-9]*)?|\.[0-9]+)([eE][+-]?[0-9]+)?\s*")


def made(thread: ScriptThread, text: str) -> str:
    """Return a new string, after checking that it has at most `MAX_STRING` characters."""
    if len(text) > MAX_STRING:
        raise Fault(f"String too long: {len(text)} characters")
    thread.machine.charge(len(text))
    return text


@declare("get_list_length", "size")
def length(thread: ScriptThread, v: Any) -> int:
    """Return the length of a list or string."""
    if isinstance(v, (str, tuple)):
        return len(v)
    raise type_error(f"v has the type {type_name(v)}; expected a list or a string")


# The Python function has another name, because `to_str` in this module is the function of `values`.
@declare(name="to_str")
def to_string(thread: ScriptThread, val: Any) -> str:
    return made(thread, to_str(val))


@declare()
def to_num(thread: ScriptThread, str_to_convert: Any) -> float | int:
    text = string(str_to_convert, "to_num: str_to_convert")
    match = _NUMBER.fullmatch(text) if len(text) < 400 else None
    if match is None:
        raise Fault(f"to_num: '{text[:40]}' is not a number")
    is_float = "." in text or match.group(2) is not None
    return checked(float(text) if is_float or len(text) > 20 else int(text))


@declare()
def str_cat(thread: ScriptThread, op1: Any, op2: Any) -> str:
    """Convert two values with `to_str`, and return them as one string."""
    return made(thread, to_str(op1) + to_str(op2))


@declare()
def str_len(thread: ScriptThread, str: Any) -> int:
    return len(string(str, "str_len: str"))


@declare()
def str_empty(thread: ScriptThread, str: Any) -> bool:
    return not string(str, "str_empty: str")


@declare()
def str_at(thread: ScriptThread, src: Any, index: Any) -> str:
    text = string(src, "str_at: src")
    at = integer(index, "str_at: index")
    if not 0 <= at < len(text):
        raise Fault(f"str_at: index {at} is out of range; the string has {len(text)} characters")
    return text[at]


@declare()
def str_sub(thread: ScriptThread, src: Any, index: Any, len: Any = 2**31 - 1) -> str:
    """Return at most `len` characters, starting at `index`."""
    text = string(src, "str_sub: src")
    at, count = integer(index, "str_sub: index", 0), integer(len, "str_sub: len", 0)
    if at > text.__len__():
        raise Fault(f"str_sub: index {at} is out of range; the string has {text.__len__()} characters")
    return made(thread, text[at : at + count])


@declare()
def str_find(thread: ScriptThread, src: Any, target: Any, start_from: Any = 0) -> int:
    """Return the index of `target`; -1 if `src` does not contain it."""
    text, wanted = string(src, "str_find: src"), string(target, "str_find: target")
    thread.machine.charge(len(text) // 16 + len(wanted) // 16)
    return text.find(wanted, integer(start_from, "str_find: start_from", 0))


@declare()
def integer_to_binary_list(thread: ScriptThread, x: Any) -> tuple[bool, ...]:
    """Return the bits of an integer as 32 truth values, the lowest bit first."""
    value = integer(x, "integer_to_binary_list: x") & 0xFFFFFFFF
    return tuple([bool(value >> bit & 1) for bit in range(32)])


@declare()
def binary_list_to_integer(thread: ScriptThread, l: Any) -> int:  # noqa: E741
    """Return the integer whose bits are up to 32 truth values, the lowest bit first. Bit 31 is the sign."""
    if not is_list(l) or len(l) > 32:
        raise type_error("binary_list_to_integer: l must be a list of up to 32 truth values")
    value = sum(boolean(bit, "binary_list_to_integer: l") << at for at, bit in enumerate(l))
    return value - (1 << 32) if value >> 31 else value


@declare(since="3.15/5.10")
def make_list(thread: ScriptThread, length: Any, initial_value: Any, capacity: Any = 0) -> tuple[Any, ...]:
    """Return a list with `length` times the same value. As a simplification, `capacity` has no effect."""
    count = integer(length, "make_list: length", 0, MAX_ELEMENTS)
    return list_of([initial_value] * count, thread.machine.charge)


@declare()
def sqrt(thread: ScriptThread, f: Any) -> float:
    x = number(f, "sqrt: f")
    if x < 0:
        raise Fault("sqrt: f must not be negative")
    return math.sqrt(x)


@declare()
def pow(thread: ScriptThread, base: Any, exponent: Any) -> float:
    """Return a power. The result is always a float (assumed)."""
    x, y = float(number(base, "pow: base")), float(number(exponent, "pow: exponent"))
    try:
        return checked(math.pow(x, y))
    except (ArithmeticError, ValueError):
        raise Fault(f"pow({x:g}, {y:g}) is not a finite number") from None


@declare()
def exp(thread: ScriptThread, f: Any) -> float:
    try:
        return math.exp(number(f, "exp: f"))
    except OverflowError:
        raise Fault("exp: floating point overflow") from None


@declare()
def log(thread: ScriptThread, b: Any, f: Any) -> float:
    """Return the logarithm of f to base b."""
    base, x = number(b, "log: b"), number(f, "log: f")
    if base <= 0 or base == 1 or x <= 0:
        raise Fault(f"log({base:g}, {x:g}) is not a finite number")
    return math.log(x) / math.log(base)


@declare()
def sin(thread: ScriptThread, f: Any) -> float:
    return math.sin(number(f, "sin: f"))


@declare()
def cos(thread: ScriptThread, f: Any) -> float:
    return math.cos(number(f, "cos: f"))


@declare()
def tan(thread: ScriptThread, f: Any) -> float:
    return math.tan(number(f, "tan: f"))


@declare()
def asin(thread: ScriptThread, f: Any) -> float:
    return math.asin(_of_an_angle(f, "asin"))


@declare()
def acos(thread: ScriptThread, f: Any) -> float:
    return math.acos(_of_an_angle(f, "acos"))


def _of_an_angle(f: Any, name: str) -> float:
    x = number(f, f"{name}: f")
    if not -1 <= x <= 1:
        raise Fault(f"{name}: f is {x:g}; expected -1 to 1")
    return x


@declare()
def atan(thread: ScriptThread, f: Any) -> float:
    return math.atan(number(f, "atan: f"))


@declare()
def atan2(thread: ScriptThread, x: Any, y: Any) -> float:
    """Return the angle whose sine and cosine are proportional to `x` and `y`."""
    return math.atan2(number(x, "atan2: x"), number(y, "atan2: y"))


@declare()
def d2r(thread: ScriptThread, d: Any) -> float:
    return math.radians(number(d, "d2r: d"))


@declare()
def r2d(thread: ScriptThread, r: Any) -> float:
    return math.degrees(number(r, "r2d: r"))


@declare()
def floor(thread: ScriptThread, f: Any) -> float | int:
    return checked(math.floor(number(f, "floor: f")))


@declare()
def ceil(thread: ScriptThread, f: Any) -> float | int:
    return checked(math.ceil(number(f, "ceil: f")))


@declare()
def round(thread: ScriptThread, f: Any) -> float | int:
    """Round a number; halves are rounded away from zero, as in C. This function and its behaviour are assumed."""
    x = number(f, "round: f")
    return checked(math.floor(abs(x) + 0.5) * (-1 if x < 0 else 1))


@declare()
def random(thread: ScriptThread) -> float:
    """Return a random number from 0 to 1. Every run of a program gets the same sequence of numbers."""
    return thread.machine.random.random()


@declare()
def norm(thread: ScriptThread, a: Any) -> float | int:
    """Return the length of a vector, or the magnitude of a number."""
    if a.__class__ is int or a.__class__ is float:
        return checked(-a if a < 0 else a)
    items = numbers(a, "norm: a")
    thread.machine.charge(len(items))
    return checked(math.hypot(*items))


@declare(since="3.14/5.9")
def transpose(thread: ScriptThread, m: Any) -> Matrix:
    return transposed(m, thread.machine.charge)


@declare()
def normalize(thread: ScriptThread, v: Any) -> tuple[float, ...]:
    items = numbers(v, "normalize: v")
    thread.machine.charge(len(items))
    length = checked(math.hypot(*items))
    if not length:
        raise Fault("normalize: the length of v is 0; expected a vector with a length above 0")
    return tuple([item / length for item in items])

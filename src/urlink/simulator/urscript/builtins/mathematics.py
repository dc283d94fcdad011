"""Functions of numbers."""

from __future__ import annotations

import math
from typing import Any

from ..errors import Fault
from ..machine import ScriptThread
from ..matrices import Matrix, transposed
from ..values import checked
from .declaration import Family, number, numbers

__all__ = ["FAMILY"]

FAMILY = Family()


@FAMILY.declare()
def sqrt(thread: ScriptThread, f: Any) -> float:
    x = number(f, "sqrt: f")
    if x < 0:
        raise Fault("sqrt of a negative number")
    return math.sqrt(x)


@FAMILY.declare()
def pow(thread: ScriptThread, base: Any, exponent: Any) -> float:
    """Always a float (a guess)."""
    x, y = float(number(base, "pow: base")), float(number(exponent, "pow: exponent"))
    try:
        return checked(math.pow(x, y))
    except (ArithmeticError, ValueError):
        raise Fault(f"pow({x:g}, {y:g}) is no finite number") from None


@FAMILY.declare()
def exp(thread: ScriptThread, f: Any) -> float:
    try:
        return math.exp(number(f, "exp: f"))
    except OverflowError:
        raise Fault("exp: floating point overflow") from None


@FAMILY.declare()
def log(thread: ScriptThread, b: Any, f: Any) -> float:
    """The logarithm of f to base b."""
    base, x = number(b, "log: b"), number(f, "log: f")
    if base <= 0 or base == 1 or x <= 0:
        raise Fault(f"log({base:g}, {x:g}) is no finite number")
    return math.log(x) / math.log(base)


@FAMILY.declare()
def sin(thread: ScriptThread, f: Any) -> float:
    return math.sin(number(f, "sin: f"))


@FAMILY.declare()
def cos(thread: ScriptThread, f: Any) -> float:
    return math.cos(number(f, "cos: f"))


@FAMILY.declare()
def tan(thread: ScriptThread, f: Any) -> float:
    return math.tan(number(f, "tan: f"))


@FAMILY.declare()
def asin(thread: ScriptThread, f: Any) -> float:
    return math.asin(_of_an_angle(f, "asin"))


@FAMILY.declare()
def acos(thread: ScriptThread, f: Any) -> float:
    return math.acos(_of_an_angle(f, "acos"))


def _of_an_angle(f: Any, name: str) -> float:
    x = number(f, f"{name}: f")
    if not -1 <= x <= 1:
        raise Fault(f"{name} of {x:g}, which is not from -1 to 1")
    return x


@FAMILY.declare()
def atan(thread: ScriptThread, f: Any) -> float:
    return math.atan(number(f, "atan: f"))


@FAMILY.declare()
def atan2(thread: ScriptThread, x: Any, y: Any) -> float:
    """The angle of the sine x and the cosine y."""
    return math.atan2(number(x, "atan2: x"), number(y, "atan2: y"))


@FAMILY.declare()
def d2r(thread: ScriptThread, d: Any) -> float:
    return math.radians(number(d, "d2r: d"))


@FAMILY.declare()
def r2d(thread: ScriptThread, r: Any) -> float:
    return math.degrees(number(r, "r2d: r"))


@FAMILY.declare()
def floor(thread: ScriptThread, f: Any) -> float | int:
    return checked(math.floor(number(f, "floor: f")))


@FAMILY.declare()
def ceil(thread: ScriptThread, f: Any) -> float | int:
    return checked(math.ceil(number(f, "ceil: f")))


@FAMILY.declare()
def round(thread: ScriptThread, f: Any) -> float | int:
    """Round halves away from zero, as in C. This and the function itself are guesses."""
    x = number(f, "round: f")
    return checked(math.floor(abs(x) + 0.5) * (-1 if x < 0 else 1))


@FAMILY.declare()
def random(thread: ScriptThread) -> float:
    """From 0 to 1; the same numbers in every run of a program."""
    return thread.machine.random.random()


@FAMILY.declare()
def norm(thread: ScriptThread, a: Any) -> float | int:
    """The length of a vector, or the magnitude of a number."""
    if a.__class__ is int or a.__class__ is float:
        return checked(-a if a < 0 else a)
    items = numbers(a, "norm: a")
    thread.machine.charge(len(items))
    return checked(math.hypot(*items))


@FAMILY.declare(since="3.14/5.9")
def transpose(thread: ScriptThread, m: Any) -> Matrix:
    return transposed(m, thread.machine.charge)


@FAMILY.declare()
def normalize(thread: ScriptThread, v: Any) -> tuple[float, ...]:
    items = numbers(v, "normalize: v")
    thread.machine.charge(len(items))
    length = checked(math.hypot(*items))
    if not length:
        raise Fault("normalize of a vector without length")
    return tuple([item / length for item in items])

"""Arithmetic of SMR-CL: doubles, with the same results as in C even if Python would raise an exception.

Python raises an exception for some operations that return inf or nan in C (``1/0``, ``ln(0)``, ``exp(1000)``), so all
these operations are wrapped. Arithmetic never ends a script. Angles and remainders are reduced by repeated addition as
in MRC, because the last bits of a result depend on it. A value that would need more than `REDUCTION_STEPS` steps is
reduced in one step.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping

#: The nan of x86 has its sign bit set, and C prints it as "-nan". The sign has no meaning.
NAN = -math.nan

#: Maximum number of steps of a reduction by repeated addition. MRC has no limit: there, ``rem(1e20, 1)`` never returns.
REDUCTION_STEPS = 100_000

#: C's int has 32 bits. On x86, a number that does not fit becomes the smallest int.
_INT_MIN = -(2**31)

# Numbers of C's strtod that begin with a digit or a point: hexadecimal, or decimal with an optional exponent.
_NUMBER = re.compile(
    r"0[xX](?:[0-9a-fA-F]+\.?[0-9a-fA-F]*|\.[0-9a-fA-F]+)(?:[pP][+-]?[0-9]+)?|(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?"
)


def parse_number(text: str, start: int = 0) -> tuple[float, int] | None:
    """Return the number at `start`, and the index after it; None if there is no number."""
    found = _NUMBER.match(text, start)
    if found is None:
        return None
    digits = found.group()
    if digits[:2] not in ("0x", "0X"):
        return float(digits), found.end()
    try:
        return float.fromhex(digits), found.end()
    except OverflowError:
        return math.inf, found.end()


def leading_number(text: str) -> float | None:
    """Return the number at the start of a text, as C's scanf and atof read it.

    The number can have a sign. Return None if there is no number.
    """
    text = text.lstrip(" \t\r\n\v\f")
    has_sign = text[:1] in ("-", "+")
    found = parse_number(text, int(has_sign)) if text else None
    if found is None:
        return None
    return -found[0] if text[0] == "-" else found[0]


def format_number(value: float) -> str:
    """Format as C's ``%lf``: six decimals, ``inf``, ``nan``, ``-nan``."""
    if value != value:
        return "-nan" if math.copysign(1.0, value) < 0 else "nan"
    return f"{value:.6f}"


def truncate(value: float) -> int:
    """Convert to int as C does: toward zero, and INT_MIN for a number that an int cannot hold."""
    return int(value) if -2147483649.0 < value < 2147483648.0 else _INT_MIN


def sign(value: float) -> float:
    """Return -1.0 for a number below zero, otherwise 1.0; zero and nan count as positive."""
    return -1.0 if value < 0.0 else 1.0


def divide(a: float, b: float) -> float:
    """Compute ``a / b`` as C does."""
    if b != 0.0:
        return a / b
    if a != a or a == 0.0:
        return NAN
    return math.copysign(math.inf, a) * math.copysign(1.0, b)


def power(a: float, b: float) -> float:
    """Compute C's ``pow``."""
    try:
        return math.pow(a, b)
    except OverflowError:
        # Only a negative base with an odd exponent stays negative.
        return -math.inf if a < 0.0 and math.fmod(b, 2.0) != 0.0 else math.inf
    except ValueError:
        if a == 0.0:  # a pole: 0 to a negative power
            return math.copysign(math.inf, a) if math.fmod(b, 2.0) in (1.0, -1.0) else math.inf
        return NAN


def normalize_angle(angle: float) -> float:
    """Reduce to [-pi, pi]; both ends are possible. inf and nan are not changed."""
    if not -math.inf < angle < math.inf:
        return angle
    turns = abs(angle) / math.tau
    if turns > REDUCTION_STEPS:
        return math.remainder(angle, math.tau)
    while angle > math.pi:
        angle -= math.tau
    while angle < -math.pi:
        angle += math.tau
    return angle


def remainder_inclusive(a: float, b: float) -> float:
    """Compute MRC's ``rem``, which is in [0, abs(b)] with both ends.

    So ``rem(3, 3)`` is 3 and ``rem(-3, 3)`` is 0.
    """
    b = abs(b)
    if not (a > b or a < 0.0):
        return a
    if b == 0.0 or math.isinf(a) or abs(a) / b > REDUCTION_STEPS:
        return remainder_modulo(a, b)
    while a > b:
        a -= b
    while a < 0.0:
        a += b
    return a


def remainder_modulo(a: float, b: float) -> float:
    """Compute `a` modulo ``abs(b)``, in [0, abs(b)); nan if it is undefined."""
    b = abs(b)
    if b == 0.0 or math.isinf(a) or a != a or b != b:
        return NAN
    found = math.fmod(a, b)
    if found >= 0.0:
        return found + 0.0
    # A tiny negative remainder would be rounded up to b itself.
    return found + b if found + b < b else 0.0


def _normalize_degrees(angle: float) -> float:
    # Convert to radians first, as MRC does: the last bits differ from a reduction by 360.
    return normalize_angle(angle / 180.0 * math.pi) / math.pi * 180.0


def _logarithm(value: float) -> float:
    return -math.inf if value == 0.0 else NAN if value < 0.0 else math.log(value)


def _exponential(value: float) -> float:
    try:
        return math.exp(value)
    except OverflowError:
        return math.inf


def sine(angle: float) -> float:
    """Compute C's ``sin``; nan for an infinite angle."""
    return math.sin(angle) if math.isfinite(angle) else NAN


def cosine(angle: float) -> float:
    """Compute C's ``cos``; nan for an infinite angle."""
    return math.cos(angle) if math.isfinite(angle) else NAN


def _total(function: Callable[[float], float]) -> Callable[[float], float]:
    """Wrap `function` to return nan outside its domain and at infinity.

    Python raises an exception there.
    """

    def total(value: float) -> float:
        try:
            return function(value)
        except ValueError:
            return NAN

    return total


#: Functions of one argument, by name. `abs` is C's fabs.
UNARY_FUNCTIONS: Mapping[str, Callable[[float], float]] = {
    "sin": sine,
    "cos": cosine,
    "asin": _total(math.asin),
    "acos": _total(math.acos),
    "tan": _total(math.tan),
    "atan": math.atan,
    "ln": _logarithm,
    "exp": _exponential,
    "sqrt": _total(math.sqrt),
    "abs": math.fabs,
    "normalizeanglerad": normalize_angle,
    "normalizeangledeg": _normalize_degrees,
}

#: Functions of two arguments, by name, except `ntrue`, which counts. `rem` depends on the profile. Since Python 3.10,
#: `math.hypot` is not the function of the C library. Its last bit differs for six pairs of a thousand.
BINARY_FUNCTIONS: Mapping[str, Callable[[float, float], float]] = {"atan2": math.atan2, "hypot": math.hypot}

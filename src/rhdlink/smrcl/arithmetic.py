"""The numbers of SMR-CL: doubles with the results of C, which Python refuses in part.

Python raises where C returns inf or nan (``1/0``, ``ln(0)``, ``exp(1000)``), so each operation that can is wrapped. A
script is never ended by arithmetic. Angles and remainders are reduced by repeated addition as MRC does it, since the
last bits of a reading depend on that; a value that would need more than `REDUCTION_STEPS` steps is reduced in one.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping

#: x86 makes a nan with the sign bit set, and C prints it as "-nan". The sign means nothing.
NAN = -math.nan

#: Steps of a reduction by repeated addition. MRC has no bound: ``rem(1e20, 1)`` never returns there.
REDUCTION_STEPS = 100_000

#: C's int has 32 bits; what does not fit becomes the smallest one on x86.
_INT_MIN = -(2**31)

# What C's strtod takes that begins with a digit or a point: hexadecimal, or decimal with an optional exponent.
_NUMBER = re.compile(
    r"0[xX](?:[0-9a-fA-F]+\.?[0-9a-fA-F]*|\.[0-9a-fA-F]+)(?:[pP][+-]?[0-9]+)?|(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?"
)


def parse_number(text: str, start: int = 0) -> tuple[float, int] | None:
    """The number at `start` and the index behind it; None if there is none."""
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
    """The number that a text begins with, as C's scanf and atof take it, with a sign; None if there is none."""
    text = text.lstrip(" \t\r\n\v\f")
    has_sign = text[:1] in ("-", "+")
    found = parse_number(text, int(has_sign)) if text else None
    if found is None:
        return None
    return -found[0] if text[0] == "-" else found[0]


def format_number(value: float) -> str:
    """As C's ``%lf`` prints it: six decimals, ``inf``, ``nan``, ``-nan``."""
    if value != value:
        return "-nan" if math.copysign(1.0, value) < 0 else "nan"
    return f"{value:.6f}"


def truncate(value: float) -> int:
    """As C converts a double to int: toward zero, and INT_MIN for what an int cannot hold."""
    return int(value) if -2147483649.0 < value < 2147483648.0 else _INT_MIN


def sign(value: float) -> float:
    """-1.0 below zero, else 1.0: zero and nan count as positive."""
    return -1.0 if value < 0.0 else 1.0


def divide(a: float, b: float) -> float:
    """``a / b``."""
    if b != 0.0:
        return a / b
    if a != a or a == 0.0:
        return NAN
    return math.copysign(math.inf, a) * math.copysign(1.0, b)


def power(a: float, b: float) -> float:
    """C's ``pow``."""
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
    """Into [-pi, pi], both ends possible; inf and nan stay what they are."""
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
    """MRC's ``rem``: into [0, abs(b)] with both ends, so that ``rem(3, 3)`` is 3 and ``rem(-3, 3)`` is 0."""
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
    """`a` modulo ``abs(b)``: into [0, abs(b)); nan where there is none."""
    b = abs(b)
    if b == 0.0 or math.isinf(a) or a != a or b != b:
        return NAN
    found = math.fmod(a, b)
    if found >= 0.0:
        return found + 0.0
    # A tiny negative remainder would be rounded up to b itself.
    return found + b if found + b < b else 0.0


def _normalize_degrees(angle: float) -> float:
    # By way of radians, as MRC does it: the last bits differ from a reduction by 360.
    return normalize_angle(angle / 180.0 * math.pi) / math.pi * 180.0


def _logarithm(value: float) -> float:
    return -math.inf if value == 0.0 else NAN if value < 0.0 else math.log(value)


def _exponential(value: float) -> float:
    try:
        return math.exp(value)
    except OverflowError:
        return math.inf


def sine(angle: float) -> float:
    """C's ``sin``: nan of an infinite angle."""
    return math.sin(angle) if math.isfinite(angle) else NAN


def cosine(angle: float) -> float:
    """C's ``cos``: nan of an infinite angle."""
    return math.cos(angle) if math.isfinite(angle) else NAN


def _total(function: Callable[[float], float]) -> Callable[[float], float]:
    """`function` with nan where Python raises: outside of its domain, and at infinity."""

    def total(value: float) -> float:
        try:
            return function(value)
        except ValueError:
            return NAN

    return total


#: Functions of one argument by name. `abs` is C's fabs.
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

#: Functions of two arguments by name, but for `ntrue`, which counts. `rem` depends on the profile. `math.hypot` is not
#: that of the C library (from Python 3.10 on), and differs from it in the last bit for six pairs of a thousand.
BINARY_FUNCTIONS: Mapping[str, Callable[[float, float], float]] = {"atan2": math.atan2, "hypot": math.hypot}

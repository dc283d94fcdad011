"""Unpublished numbers of robots, each with its evidence, from the table `parameters.tsv`.

Each row has a name, the object it applies to (an arm, a joint size, or ""), the value, the interval that contains the
value according to all evidence, the unit, the kind of evidence, the source as text, and the module that uses the value.
The kinds of evidence are:

- **log**: recorded bytes or a log of a real arm, or of the vendor's simulated arm, show the value;
- **document**: a document of the vendor states the value;
- **thread**: users, or authors of other software, report the value;
- **analogy**: the value is the known value of a similar object;
- **guess**: the value is estimated without evidence. The interval shows how large the error can be.

The value "assumed" is not a number. The value "assumed" marks a behaviour that is assumed. The name and the source of
the row describe this behaviour. All modules read their numbers here, so that each number is defined in one place.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Literal, cast

from linkcore.errors import BadValue

__all__ = ["Evidence", "Parameter", "is_assumed", "number", "numbers", "parameters"]

#: Kind of evidence for a value; see the docstring of the module.
Evidence = Literal["log", "document", "thread", "analogy", "guess"]

_TABLE = Path(__file__).with_name("parameters.tsv")


@dataclass(frozen=True)
class Parameter:
    """One row of the table.

    Attributes:
        name: Name, unique together with `of`.
        of: Object that the value applies to: the name of an arm, joint size or generation, or "".
        value: One number, six numbers separated by blanks, "yes" or "no", "as" with the name of another object (such as
            "as UR5e"), or "assumed".
        low: Lower end of the interval of the value; None if no number is known.
        high: Upper end of this interval; None if no number is known.
        unit: Unit; "" for a ratio, or if the value has no unit.
        evidence: Kind of evidence.
        source: Source of the value, as text.
        used: Module that uses the value, relative to `urlink`.
    """

    name: str
    of: str
    value: str
    low: float | None
    high: float | None
    unit: str
    evidence: Evidence
    source: str
    used: str


@cache
def parameters() -> dict[tuple[str, str], Parameter]:
    """Return the rows of the table. The key of a row is its name and the object that it applies to."""
    found: dict[tuple[str, str], Parameter] = {}
    for line in _TABLE.read_text(encoding="utf-8").splitlines()[1:]:
        name, of, value, low, high, unit, evidence, source, used = line.split("\t")
        ends = float(low) if low else None, float(high) if high else None
        found[name, of] = Parameter(name, of, value, *ends, unit, cast(Evidence, evidence), source, used)
    return found


def number(name: str, of: str = "") -> float:
    """Return the value of a parameter with a single number.

    Raises:
        BadValue: If the parameter does not exist.

    >>> number("rotor_inertia", "size 2")
    0.587
    """
    return float(_value(name, of))


def numbers(name: str, of: str = "") -> tuple[float, ...]:
    """Return the values of a parameter with one or more numbers, for example of six joints from base to wrist 3.

    Raises:
        BadValue: If the parameter does not exist.
    """
    return tuple(map(float, _value(name, of).split()))


def is_assumed(name: str) -> bool:
    """Return whether the value of a parameter is "yes". The value of such a parameter is "yes" or "no".

    Raises:
        BadValue: If the parameter does not exist.
    """
    return _value(name, "") == "yes"


def _value(name: str, of: str) -> str:
    try:
        return parameters()[name, of].value
    except KeyError:
        raise BadValue(f"unknown parameter {name!r}{f' of {of!r}' if of else ''}; see parameters.tsv") from None

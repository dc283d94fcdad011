"""Unpublished numbers of robots, each with its evidence, from the table `parameters.tsv`.

Each row has a name, the object it applies to (an arm, a joint size, or ""), the value, the interval that contains it
according to all evidence, the unit, the evidence, the source as text, and the module that uses it. The kinds of
evidence are:

- **log**: bytes or a log of a real arm, or of the vendor's simulated arm, show it;
- **document**: a document of the vendor states it;
- **thread**: users, or authors of other software, report it;
- **analogy**: it is the known value of a similar object;
- **guess**: only judgement. The interval shows how large the error can be.

The value "assumed" is not a number: it stands for a behaviour, which the name and the source describe. All modules read
their numbers here, so that each number is defined in one place.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Literal, cast

from linkcore.errors import BadValue

__all__ = ["Evidence", "Parameter", "is_assumed", "number", "numbers", "parameters"]

#: Kind of evidence for a value; see the text of the module.
Evidence = Literal["log", "document", "thread", "analogy", "guess"]

_TABLE = Path(__file__).with_name("parameters.tsv")


@dataclass(frozen=True)
class Parameter:
    """One row of the table.

    Attributes:
        name: Name, unique together with `of`.
        of: Name of an arm, joint size or generation, or "".
        value: One number, six numbers separated by blanks, "yes" or "no", "as" something else, or "assumed".
        low: Lower end of the interval of the value; None if no number is known.
        high: Upper end of this interval; None if no number is known.
        unit: Unit; "" for a ratio, or if there is none.
        evidence: Kind of evidence.
        source: Source of the value, as text.
        used: Module below `urlink` that uses the value.
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
    """Return the table, by the names of the parameters and of the objects that they apply to."""
    found: dict[tuple[str, str], Parameter] = {}
    for line in _TABLE.read_text(encoding="utf-8").splitlines()[1:]:
        name, of, value, low, high, unit, evidence, source, used = line.split("\t")
        ends = float(low) if low else None, float(high) if high else None
        found[name, of] = Parameter(name, of, value, *ends, unit, cast(Evidence, evidence), source, used)
    return found


def number(name: str, of: str = "") -> float:
    """Return the value of a parameter that is one number.

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
    """Return the value of a parameter that is "yes" or "no".

    Raises:
        BadValue: If the parameter does not exist.
    """
    return _value(name, "") == "yes"


def _value(name: str, of: str) -> str:
    try:
        return parameters()[name, of].value
    except KeyError:
        raise BadValue(f"unknown parameter {name!r}{f' of {of!r}' if of else ''}; see parameters.tsv") from None

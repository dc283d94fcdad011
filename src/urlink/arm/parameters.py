"""Unpublished numbers of robots, each with its evidence: the table `parameters.tsv`.

A row has the name, what it is of (an arm, a size of joint, or nothing in particular), the value, the interval in which
it lies for all that is known, the unit, the evidence, the source as text, and the module that stands on it:

- **log**: bytes or a log of a real or of the vendor's simulated arm show it;
- **document**: the vendor says so;
- **thread**: users or the authors of other software report it;
- **analogy**: it is that of something like it of which it is known;
- **guess**: nothing but judgement. The interval says how far it may be off.

A value of "assumed" is not a number but how something behaves, which the name and the source say. Modules read their
numbers here, so that each stands in one place.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Literal, cast

from linkcore.errors import BadValue

__all__ = ["Evidence", "Parameter", "is_assumed", "number", "numbers", "parameters"]

#: What backs a value; see the text of the module.
Evidence = Literal["log", "document", "thread", "analogy", "guess"]

_TABLE = Path(__file__).with_name("parameters.tsv")


@dataclass(frozen=True)
class Parameter:
    """One row.

    Attributes:
        name: unique with `of`.
        of: the name of an arm, a size of joint, a generation, or "".
        value: a number, six of them with blanks between, "yes" or "no", "as" something else, or "assumed".
        low, high: the interval in which it lies; None where no number is known.
        unit: "" for a ratio, and where there is none.
        evidence: what backs it.
        source: that as text.
        used: the module below `urlink` that stands on it.
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
    """The table, by name and by what each is of."""
    found: dict[tuple[str, str], Parameter] = {}
    for line in _TABLE.read_text(encoding="utf-8").splitlines()[1:]:
        name, of, value, low, high, unit, evidence, source, used = line.split("\t")
        ends = float(low) if low else None, float(high) if high else None
        found[name, of] = Parameter(name, of, value, *ends, unit, cast(Evidence, evidence), source, used)
    return found


def number(name: str, of: str = "") -> float:
    """The value of a parameter that is one number.

    Raises:
        BadValue: no such parameter.

    >>> number("rotor_inertia", "size 2")
    0.587
    """
    return float(_value(name, of))


def numbers(name: str, of: str = "") -> tuple[float, ...]:
    """The values of a parameter that is several numbers, or one: of six joints from base to wrist 3, say.

    Raises:
        BadValue: no such parameter.
    """
    return tuple(map(float, _value(name, of).split()))


def is_assumed(name: str) -> bool:
    """The value of a parameter that is "yes" or "no".

    Raises:
        BadValue: no such parameter.
    """
    return _value(name, "") == "yes"


def _value(name: str, of: str) -> str:
    try:
        return parameters()[name, of].value
    except KeyError:
        raise BadValue(f"no parameter is called {name!r}{f' of {of!r}' if of else ''}") from None

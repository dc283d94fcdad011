"""Requirement files: requirements with their limits, reasons, and the sources of the limits.

The files are TOML, limited to tables, strings, numbers, true and false. Each value is on one line and is written as in
JSON. `tomllib` can read the files too, but Python 3.10 does not have it. In your own file, you can change the limits of
requirements that you name, and describe the cell in a table `site`. The checks of the evidence compare measured values
with the limits.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from urlink import BadValue
from urlink.tools import FloatArray

if TYPE_CHECKING:
    from .evidence import Evidence

_TABLE = Path(__file__).with_name("requirements.toml")
_HEAD = re.compile(r"\[([a-z][a-z0-9-]*)\]")
_PAIR = re.compile(r"([a-z][a-z0-9_]*) *= *(.*)")
#: Name of the table that describes the cell.
_SITE = "site"
#: Keys of a requirement, and the keys that your own file may change.
_KEYS, _OWN = ("stage", "what", "limit", "unit", "why", "source"), ("limit", "why", "source")


@dataclass(frozen=True)
class Requirement:
    """One requirement.

    Attributes:
        name: Name, used in tests, reports and your own files.
        stage: Stage of the test that tries the requirement.
        what: Description of the measured value.
        limit: Largest measured value with which the requirement is held.
        unit: Unit of the limit; "" for a count or a ratio.
        why: Reason for the requirement.
        source: Source of the limit.
    """

    name: str
    stage: int
    what: str
    limit: float
    unit: str
    why: str
    source: str


class Measured(NamedTuple):
    """Result of a check.

    Attributes:
        value: Measured value, which is compared with the limit.
        seen: Description of the result.
        contradicts: Parameters of `urlink.arm.parameters` that the result contradicts, each with the measured value.
    """

    value: float
    seen: str
    contradicts: tuple[str, ...] = ()


class NotTried(Exception):
    """Raised if the evidence contains nothing to judge. The message is the reason."""


def how_different(expected: FloatArray, measured: FloatArray) -> str:
    """Return a description of the likely difference of a measured vector from an expected one, within 20 %.

    >>> how_different(np.array([1.0, 4.0]), np.array([-1.0, -4.1]))
    'its sign is inverted'
    >>> how_different(np.array([1.0, 4.0]), np.array([2000.0, 8000.0]))
    'it is 2e+03 times as large'
    """
    size = float(np.linalg.norm(expected))

    def near(other: FloatArray) -> bool:
        return float(np.linalg.norm(expected - other)) < 0.2 * size

    if size < 1e-9:
        return "other values"
    if not np.any(measured):
        return "it is zero"
    if near(-measured):
        return "its sign is inverted"
    ratio = float(expected @ measured) / size**2
    if abs(ratio) > 1e-6 and near(measured / ratio):
        return f"it is {ratio:.3g} times as large"
    if near(np.sort(measured) - np.sort(expected) + expected):
        return "its components are in another order"
    return "other values"


Check = Callable[["Evidence"], Measured]

#: Maximum number of items that one verdict names.
_MOST = 6


def counted(wrong: Sequence[str], otherwise: str) -> Measured:
    """Return the number of wrong items and their names, or `otherwise` if nothing is wrong."""
    if not wrong:
        return Measured(0.0, otherwise)
    more = f"; and {len(wrong) - _MOST} more" if len(wrong) > _MOST else ""
    return Measured(float(len(wrong)), "; ".join(wrong[:_MOST]) + more)


@cache
def requirements() -> Mapping[str, Requirement]:
    """Return the requirements of this library, by name, stage by stage."""
    return read(_TABLE.read_text(encoding="utf-8"), str(_TABLE))[0]


def read(text: str, where: str) -> tuple[Mapping[str, Requirement], Mapping[str, Any]]:
    """Parse a complete file; return the requirements and the table `site`, which is empty if the file has none.

    Raises:
        BadValue: If the text is not a table of requirements, or a requirement is incomplete.
    """
    tables = _tables(text, where)
    site = tables.pop(_SITE, {})
    for name, table in tables.items():
        if table.keys() != set(_KEYS):
            raise BadValue(f"{where}: [{name}] has {', '.join(table)}; expected {', '.join(_KEYS)}")
    return {name: Requirement(name, **table) for name, table in tables.items()}, site


def written(requirements: Mapping[str, Requirement], site: Mapping[str, Any]) -> str:
    """Return the text of a complete file, which `read` can parse."""
    tables = {_SITE: dict(site)} if site else {}
    tables |= {name: {key: getattr(each, key) for key in _KEYS} for name, each in requirements.items()}
    return "\n".join(
        f"[{name}]\n" + "".join(f"{key} = {json.dumps(value)}\n" for key, value in table.items())
        for name, table in tables.items()
    )


def from_file(path: Path) -> tuple[Mapping[str, Requirement], Mapping[str, Any]]:
    """Return the requirements with the changes of your own file, and the table `site` of the file, which can be empty.

    Raises:
        BadValue: If the file cannot be read, is not a requirement file, or names a requirement that does not exist.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise BadValue(f"cannot read the requirement file {path}: {error}") from None
    tables = _tables(text, str(path))
    site = tables.pop(_SITE, {})
    found = dict(requirements())
    for name, table in tables.items():
        if name not in found:
            raise BadValue(f"{path}: unknown requirement {name!r}; expected one of {', '.join(found)}")
        if wrong := [key for key in table if key not in _OWN]:
            raise BadValue(f"{path}: [{name}] sets {', '.join(wrong)}; your own file can set only {', '.join(_OWN)}")
        limit = table.get("limit", 0.0)
        if isinstance(limit, bool) or not isinstance(limit, int | float) or not 0 <= limit < math.inf:
            raise BadValue(f"{path}: [{name}] has limit = {limit!r}; expected a number of 0 or more")
        found[name] = replace(found[name], **table)
    return found, site


def _tables(text: str, where: str) -> dict[str, dict[str, Any]]:
    tables: dict[str, dict[str, Any]] = {}
    table: dict[str, Any] | None = None
    for number, line in enumerate(map(str.strip, text.splitlines()), 1):
        if not line or line.startswith("#"):
            continue
        head, pair = _HEAD.fullmatch(line), _PAIR.fullmatch(line)
        if head is not None and head[1] not in tables:
            table = tables[head[1]] = {}
            continue
        if pair is None or table is None or pair[1] in table:
            raise BadValue(f"{where}, line {number}: {line[:80]!r}; expected [name] or key = value, each once")
        try:
            table[pair[1]] = json.loads(pair[2])
        except (ValueError, RecursionError):
            raise BadValue(f"{where}, line {number}: invalid value {pair[2][:80]!r}; expected a JSON value") from None
    return tables

"""Requirement files: what has to hold, up to which limit, why, and where the limit comes from.

They are TOML, in the part of it in which a value stands on one line and is written as in JSON: tables, texts, numbers,
true and false. `tomllib` reads them too; Python 3.10 has none. A file of one's own changes limits by the names of the
requirements, and says in a table `site` whose cell it is. What a check of the evidence measures is compared with them.
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

from urlink import BadValue

if TYPE_CHECKING:
    from .evidence import Evidence

_TABLE = Path(__file__).with_name("requirements.toml")
_HEAD = re.compile(r"\[([a-z][a-z0-9-]*)\]")
_PAIR = re.compile(r"([a-z][a-z0-9_]*) *= *(.*)")
#: What stands in the table of one's own cell.
_SITE = "site"
#: What a requirement has, and what of it a file of one's own may change.
_KEYS, _OWN = ("stage", "what", "limit", "unit", "why", "source"), ("limit", "why", "source")


@dataclass(frozen=True)
class Requirement:
    """One requirement.

    Attributes:
        name: by which tests, reports and files of one's own refer to it.
        stage: of the test in which it is tried.
        what: is measured.
        limit: the most that is held.
        unit: of the limit; "" for a number of things or a ratio.
        why: it is required.
        source: of the limit.
    """

    name: str
    stage: int
    what: str
    limit: float
    unit: str
    why: str
    source: str


class Measured(NamedTuple):
    """What was found.

    Attributes:
        value: what was measured; compared with the limit.
        seen: in words.
        contradicts: parameters of `urlink.arm.parameters` that are refuted by it, each with what was measured.
    """

    value: float
    seen: str
    contradicts: tuple[str, ...] = ()


class NotTried(Exception):
    """There is nothing in the evidence by which it could be judged; says why."""


Check = Callable[["Evidence"], Measured]

#: Things that are named in one verdict.
_MOST = 6


def counted(wrong: Sequence[str], otherwise: str) -> Measured:
    """How many things are wrong, and which; `otherwise` is the text where none is."""
    if not wrong:
        return Measured(0.0, otherwise)
    more = f"; and {len(wrong) - _MOST} more" if len(wrong) > _MOST else ""
    return Measured(float(len(wrong)), "; ".join(wrong[:_MOST]) + more)


@cache
def requirements() -> Mapping[str, Requirement]:
    """The requirements that come with the library, by name, stage by stage."""
    return read(_TABLE.read_text(encoding="utf-8"), str(_TABLE))[0]


def read(text: str, where: str) -> tuple[Mapping[str, Requirement], Mapping[str, Any]]:
    """The requirements of a whole file, and its table `site`, empty where it has none.

    Raises:
        BadValue: not a table of requirements, or one of them lacks something.
    """
    tables = _tables(text, where)
    site = tables.pop(_SITE, {})
    for name, table in tables.items():
        if table.keys() != set(_KEYS):
            raise BadValue(f"{where}: [{name}] has {', '.join(table)}; expected {', '.join(_KEYS)}")
    return {name: Requirement(name, **table) for name, table in tables.items()}, site


def written(requirements: Mapping[str, Requirement], site: Mapping[str, Any]) -> str:
    """The text of a whole file, as `read` reads it."""
    tables = {_SITE: dict(site)} if site else {}
    tables |= {name: {key: getattr(each, key) for key in _KEYS} for name, each in requirements.items()}
    return "\n".join(
        f"[{name}]\n" + "".join(f"{key} = {json.dumps(value)}\n" for key, value in table.items())
        for name, table in tables.items()
    )


def from_file(path: Path) -> tuple[Mapping[str, Requirement], Mapping[str, Any]]:
    """The requirements as a file of one's own changes them, and its table `site`, empty where it has none.

    Raises:
        BadValue: the file cannot be read, holds no limits, or names a requirement that there is not.
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
            raise BadValue(f"{path}: no requirement is called {name!r}; there are {', '.join(found)}")
        if not table.keys() <= set(_OWN):
            raise BadValue(f"{path}: [{name}] has {', '.join(table)}; a file of one's own changes {', '.join(_OWN)}")
        limit = table.get("limit", 0.0)
        if isinstance(limit, bool) or not isinstance(limit, int | float) or not 0 <= limit < math.inf:
            raise BadValue(f"{path}: [{name}] has limit = {limit!r}; expected a number from 0 on")
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
            raise BadValue(f"{where}, line {number}: {pair[2][:80]!r} is no value; expected one as JSON has") from None
    return tables

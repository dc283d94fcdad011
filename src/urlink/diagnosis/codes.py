"""Codes with which a controller reports a stop, such as C153A1, from the table `codes.tsv`.

The meaning of the codes is from the vendor's list of error codes (version 40.121.0), which UR Client Library contains
as `error_codes.h`. The texts are our own words. The vendor's service note names C153 and C157 as the most frequent
codes of protective stops. Code 403 is not in the part of the list that was read. A thread of the vendor's forum
describes it (16142).

An argument names a joint, or selects one of several meanings. A row with the argument "joint" is valid for the
arguments 0 to 5. The arguments 6 to 11 of C173 and C174 name the same joints.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Literal, NamedTuple

from ..arm.vectors import JOINTS

#: Kind of evidence for the meaning of a code: the vendor's list, or reports of users.
Evidence = Literal["document", "thread"]

_TABLE = Path(__file__).with_name("codes.tsv")
_SOURCES: dict[Evidence, str] = {
    "document": "error_codes.h of UR Client Library, the vendor's list 40.121.0",
    "thread": "thread 16142 of the vendor's forum",
}
#: Arguments of codes whose argument is a joint plus this number.
_SHIFTED = "32+joint"


class Code(NamedTuple):
    """Meaning of a code of the controller.

    Attributes:
        name: Name, such as "C153A1".
        cause: Cause that the code stands for, such as "position deviation".
        joint: Number of the joint, 0 to 5; None if the code does not name one.
        text: Meaning, in our own words.
        source: Source of the meaning.
        evidence: Kind of evidence.
    """

    name: str
    cause: str
    joint: int | None
    text: str
    source: str
    evidence: Evidence


@cache
def _rows() -> dict[tuple[int, str], tuple[str, str, Evidence]]:
    rows: dict[tuple[int, str], tuple[str, str, Evidence]] = {}
    for line in _TABLE.read_text(encoding="utf-8").splitlines()[1:]:
        code, arguments, cause, text, evidence = line.split("\t")
        assert evidence in _SOURCES, f"{code}: unknown kind of evidence {evidence!r}"
        rows[int(code), arguments] = cause, text, evidence
    return rows


def code_of(code: int, argument: int) -> Code | None:
    """Return the meaning of a code with its argument; None if the code is not in the table."""
    rows, joint = _rows(), None
    row = rows.get((code, str(argument))) or rows.get((code, "")) or rows.get((code, "any"))
    if row is None and (code, "joint") in rows and 0 <= argument < 2 * len(JOINTS):
        row, joint = rows[code, "joint"], argument % len(JOINTS)
    if row is None and (code, _SHIFTED) in rows and 0 <= argument - 32 < len(JOINTS):
        row, joint = rows[code, _SHIFTED], argument - 32
    if row is None:
        return None
    cause, text, evidence = row
    return Code(f"C{code}A{max(argument, 0)}", cause, joint, text, _SOURCES[evidence], evidence)


def known_codes() -> list[tuple[int, str, str, str, Evidence]]:
    """Return the rows of the table: code, arguments, cause, text and kind of evidence."""
    return [(code, arguments, *row) for (code, arguments), row in _rows().items()]

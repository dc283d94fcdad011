"""Every term of the glossary is in the code where the glossary says."""

from __future__ import annotations

import importlib
import importlib.util
import re
from pathlib import Path
from typing import NamedTuple

import pytest

GLOSSARY = Path(__file__).resolve().parents[1] / "docs" / "glossary.md"


class Term(NamedTuple):
    name: str
    meaning: str
    place: str


def terms() -> list[Term]:
    rows = [line.strip("|").split("|") for line in GLOSSARY.read_text(encoding="utf-8").splitlines() if line[:1] == "|"]
    found = [Term(*(cell.strip() for cell in row)) for row in rows]
    return [term for term in found if not re.fullmatch(r"Term|-+", term.name)]


TERMS = terms()


def test_no_term_has_two_meanings() -> None:
    names = [term.name for term in TERMS]
    assert sorted(names) == sorted(set(names))
    assert all(term.meaning for term in TERMS)


@pytest.mark.parametrize("term", TERMS, ids=lambda term: term.name)
def test_it_is_where_the_glossary_says(term: Term) -> None:
    place = term.place.strip("`")
    try:
        is_module = importlib.util.find_spec(place) is not None
    except ModuleNotFoundError:  # its parent is no package
        is_module = False
    if not is_module:
        module, _, name = place.rpartition(".")
        assert hasattr(importlib.import_module(module), name)

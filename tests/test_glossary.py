"""Every term of the glossary exists in the module, class or function that the glossary names."""

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
    text = GLOSSARY.read_text(encoding="utf-8")
    found = re.findall(r"^- \*\*(.+?)\*\*: (.+) \(`([\w.]+)`\)$", text, re.MULTILINE)
    assert len(found) == text.count("\n- ") > 20
    return [Term(*each) for each in found]


TERMS = terms()


def test_glossary_terms_are_unique() -> None:
    names = [term.name for term in TERMS]
    assert sorted(names) == sorted(set(names))
    assert all(term.meaning for term in TERMS)


@pytest.mark.parametrize("term", TERMS, ids=lambda term: term.name)
def test_glossary_term_exists_in_its_module(term: Term) -> None:
    try:
        is_module = importlib.util.find_spec(term.place) is not None
    except ModuleNotFoundError:  # the parent is not a package
        is_module = False
    if not is_module:
        module, _, name = term.place.rpartition(".")
        assert hasattr(importlib.import_module(module), name)

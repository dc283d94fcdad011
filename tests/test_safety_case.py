"""docs/safety-case.md: each cited test exists, and each hazard has a test or an owner."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PAGE = (ROOT / "docs" / "safety-case.md").read_text(encoding="utf-8")

#: Items of the lists of hazards, each in one line.
HAZARDS = re.findall(r"^- (.*)$", re.sub(r"\n +", " ", PAGE.split("## Hazards")[1].split("\n## ")[0]), re.MULTILINE)
TESTS = sorted(set(re.findall(r"`([\w/]+\.py)::(\w+)`", PAGE)))


def test_safety_case_lists_tests_and_hazards() -> None:
    assert len(TESTS) > 20
    assert len(HAZARDS) > 20


@pytest.mark.parametrize(("file", "name"), TESTS)
def test_cited_test_exists(file: str, name: str) -> None:
    path = ROOT / file if file.startswith("packages/") else ROOT / "tests" / "urlink" / file
    assert re.search(rf"^def {name}\(", path.read_text(encoding="utf-8"), re.MULTILINE)


@pytest.mark.parametrize("hazard", HAZARDS, ids=lambda hazard: hazard[2:40])
def test_hazard_names_a_test_or_an_owner(hazard: str) -> None:
    assert "::" in hazard or "You have to" in hazard, hazard


def test_security_page_links_the_safety_case() -> None:
    assert "docs/safety-case.md" in (ROOT / "SECURITY.md").read_text(encoding="utf-8")

"""docs/safety-case.md: each reference leads somewhere, and each hazard has a test or an owner."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PAGE = (ROOT / "docs" / "safety-case.md").read_text(encoding="utf-8")

TESTS = sorted(set(re.findall(r"`([\w/]+\.py)::(\w+)`", PAGE)))


def test_there_is_something_to_follow() -> None:
    assert len(TESTS) > 20


@pytest.mark.parametrize(("file", "name"), TESTS)
def test_a_test_is_there(file: str, name: str) -> None:
    assert re.search(rf"^def {name}\(", (ROOT / "tests" / "urlink" / file).read_text(encoding="utf-8"), re.MULTILINE)


@pytest.mark.parametrize(
    "line", [line for line in PAGE.splitlines() if line.startswith("| ") and "Held by" not in line]
)
def test_each_hazard_is_held_or_is_yours(line: str) -> None:
    cells = [cell.strip() for cell in line.strip("|").split("|")]
    if len(cells) == 3 and "---" not in line and "::" not in line:
        assert "yours" in cells[2] or cells[0].startswith(("**", "By")) or not cells[0], line


def test_the_page_about_security_points_there() -> None:
    assert "docs/safety-case.md" in (ROOT / "SECURITY.md").read_text(encoding="utf-8")

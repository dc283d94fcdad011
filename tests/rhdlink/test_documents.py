"""The statements of the documentation about the tests must be true."""

from __future__ import annotations

import re
from pathlib import Path

from tests.listed import assert_listed

ROOT = Path(__file__).resolve().parents[2]


def test_differences_page_lists_the_tests_of_every_defect() -> None:
    page = (ROOT / "docs" / "rhd-differences.md").read_text(encoding="utf-8")
    defects = (ROOT / "tests" / "rhdlink" / "test_defects.py").read_text(encoding="utf-8")
    there = set(re.findall(r"^def (test_\d+_\w+)\(", defects, re.MULTILINE))
    assert_listed(there, re.findall(r"`(test_\w+)`", page), "docs/rhd-differences.md")
    assert [int(number) for number in re.findall(r"^\| (\d+) \|", page, re.MULTILINE)] == list(range(1, 18))


def test_sections_cited_in_rhdlink_comments_exist() -> None:
    page = (ROOT / "docs" / "protocols" / "rhd.md").read_text(encoding="utf-8")
    sections = set(re.findall(r"^#+ (.+)$", page, re.MULTILINE))
    cited = set()
    for path in (ROOT / "src" / "rhdlink").rglob("*.py"):
        # A citation may be split across two lines of a comment.
        text = re.sub(r"\n\s*#?\s*", " ", path.read_text(encoding="utf-8"))
        cited |= set(re.findall(r"docs/protocols/rhd\.md, ([A-Z][A-Za-z ]+)", text))
    assert len(cited) > 5
    missing = sorted({section.strip() for section in cited} - sections)
    assert not missing, f"docs/protocols/rhd.md lacks sections that comments in src/rhdlink cite: {', '.join(missing)}"

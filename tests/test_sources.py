"""Sources of facts that the code cites are sections of docs/protocols, so that a reader can find them."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PAGES = {page.name: page.read_text(encoding="utf-8") for page in (ROOT / "docs" / "protocols").glob("*.md")}
HEADINGS = {name: re.findall(r"^#+ (.+)$", text, re.MULTILINE) for name, text in PAGES.items()}
MODULES = sorted((ROOT / "src").rglob("*.py"))


def mentions(text: str) -> list[tuple[str, str]]:
    """Return each page that a module names, with the text after its name, on one line."""
    # A mention may continue in the next line of a comment or docstring.
    joined = re.sub(r"\s*\n\s*(?:#:? ?)?", " ", text)
    return re.findall(r"docs/protocols/(\S+?\.md)(.{0,120})", joined)


def leads_somewhere(page: str, rest: str) -> bool:
    if page not in PAGES:
        return False
    named = re.match(r"(?:, sections?|,) (.*)", rest)
    if named is None:
        return True
    return any(named[1].lower().startswith(heading.lower()) for heading in HEADINGS[page])


@pytest.mark.parametrize("package", ["linkcore", "urlink", "rhdlink"])
def test_cited_protocol_sections_exist(package: str) -> None:
    lost, seen = [], 0
    for module in MODULES:
        if package in module.parts:
            for page, rest in mentions(module.read_text(encoding="utf-8")):
                seen += 1
                if not leads_somewhere(page, rest):
                    lost.append(f"{module.relative_to(ROOT)}: {page}{rest[:60]}")
    assert not lost
    assert seen > 10 or package == "linkcore"


def test_code_does_not_cite_sources_outside_the_repository() -> None:
    outside = r"\breference\s+(ur-|rhd-|mrc|smr)"
    assert [str(module) for module in MODULES if re.search(outside, module.read_text(encoding="utf-8"))] == []


def test_leads_somewhere_rejects_missing_page_or_section() -> None:
    assert leads_somewhere("primary.md", ", section Robot state")
    assert not leads_somewhere("primary.md", ", section Robot stare")
    assert not leads_somewhere("primery.md", "")


def test_tests_cited_by_the_pages_exist() -> None:
    pages = [(ROOT / "docs" / name).read_text(encoding="utf-8") for name in ("choosing.md", "errors.md")]
    named = [each for page in pages for each in re.findall(r"`(\S+?\.py)::(test_\w+)`", page)]
    assert len(named) > 15
    missing = [
        f"{file}: {test}"
        for file, test in named
        if f"def {test}(" not in (ROOT / "tests" / file).read_text(encoding="utf-8")
    ]
    assert missing == []


def test_class_option_of_admonitions_contains_only_class_names() -> None:
    """A text after `:class: important` would be read as names of classes, and never be shown."""
    pages = [page.read_text(encoding="utf-8") for page in (ROOT / "docs").rglob("*.md")]
    classes = [each for page in pages for each in re.findall(r"^:class: (.*)$", page, re.MULTILINE)]
    assert "important" in classes
    assert not [each for each in classes if re.fullmatch(r"[\w-]+", each) is None]

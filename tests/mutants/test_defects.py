"""Defects of all kinds are found, can be made one at a time, and are drawn in a fixed order."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

from tests.mutants.defects import KINDS, defects, draw, with_defect
from tests.mutants.drawn import COUNT, SEED
from tests.mutants.targets import GROUPS


def _changed(source: str, kind: str) -> list[str]:
    """Return the source of a module with each of its defects of a kind."""
    found = [each for each in defects(source) if each.kind == kind]
    return [ast.unparse(with_defect(source, each.number)) for each in found]


@pytest.mark.parametrize(
    ("kind", "before", "after"),
    [
        ("swap", "self.a.b()\nself.c()", "self.c()\nself.a.b()"),
        ("late", "self.a = True\nself.b()\nreturn 1", "self.b()\nself.a = True\nreturn 1"),
        ("expiry", "if now > until:\n    g()", "if False:\n    g()"),
        ("expiry", "self.a.wait(timeout)", "self.a.wait(1000000.0)"),
        ("expiry", "g(timeout=seconds)", "g(timeout=1000000.0)"),
        ("lock", "with self.lock:\n    a = b()\n    c = a", "with self.lock:\n    a = b()\nc = a"),
        ("forget", "self.cancel()", "pass"),
        ("branch", "if frame == 'tool':\n    g()", "if False:\n    g()"),
        ("branch", "g(link='rtde')", "g(link='reverse')"),
    ],
)
def test_defect_changes_the_source_as_expected(kind: str, before: str, after: str) -> None:
    source, expected = (f"def f(self):\n{_indented(text)}" for text in (before, after))
    assert ast.unparse(ast.parse(expected)) in _changed(source, kind)


def _indented(text: str) -> str:
    return "\n".join(f"    {line}" for line in text.splitlines())


@pytest.mark.parametrize(
    "source",
    [
        "def f(self):\n    a = g()\n    b = a + g()",
        "def f(self):\n    log.warning(a)\n    log.info(b)",
        "def __init__(self):\n    self.a = b()\n    self.c = d()",
    ],
    ids=["dependent statements", "log calls", "constructor"],
)
def test_swap_skips_statements_whose_order_does_not_matter(source: str) -> None:
    assert _changed(source, "swap") == []


def test_draw_is_reproducible() -> None:
    files = GROUPS["drawn"].files()
    first = draw(files, SEED, COUNT)
    assert first == draw(files, SEED, COUNT)
    assert len(first) == COUNT
    assert {each.mutation.kind for each in first} == set(KINDS)


def test_drawn_defects_can_be_compiled() -> None:
    sources: dict[Path, str] = {}
    for each in draw(GROUPS["drawn"].files(), SEED, COUNT):
        source = sources.setdefault(each.path, each.path.read_text(encoding="utf-8"))
        compile(with_defect(source, each.mutation.number), str(each.path), "exec")

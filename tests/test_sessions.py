"""Sessions of nox: each states when to run it, and all sessions named by pages and workflows exist."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]


def sessions(file: str) -> dict[str, str]:
    """Map the names of the sessions of a file to the first lines of their docstrings."""
    tree = ast.parse((ROOT / file).read_text(encoding="utf-8"))
    functions = [node for node in tree.body if isinstance(node, ast.FunctionDef)]
    return {
        each.name: (ast.get_docstring(each) or "").partition("\n")[0]
        for each in functions
        if any(ast.unparse(decorator).startswith("nox.session") for decorator in each.decorator_list)
    }


DAILY = sessions("noxfile.py")
NIGHTLY = sessions("nightly.py")


def named(text: str) -> Iterator[tuple[str, bool]]:
    """Yield the first session of each command in a text, and whether it belongs to nightly.py."""
    for call in re.finditer(r"\bnox\b(?: -[Rr])*( -f nightly\.py)?(?: -[Rr])* -s ([a-z][a-z0-9_]*)", text):
        yield call[2], bool(call[1])


def readable() -> Iterator[Path]:
    """Yield the files that name sessions, for people or for machines."""
    places = ("*.md", ".github/**/*.yml", ".ci/run", "docs/**/*.md", "*/*/README.md", "src/**/*.py", "tests/**/*.py")
    for pattern in places:
        yield from (path for path in ROOT.glob(pattern) if path != Path(__file__).resolve())


@pytest.mark.parametrize("name", [*DAILY, *NIGHTLY])
def test_session_states_when_to_run_it(name: str) -> None:
    summary = {**DAILY, **NIGHTLY}[name]
    assert re.search(r"\. Run it .+\.$", summary), f"the first line of {name} does not say when to run it: {summary}"


@pytest.mark.parametrize("path", sorted({path for path in readable() if " -s " in path.read_text(encoding="utf-8")}))
def test_named_sessions_exist(path: Path) -> None:
    for name, is_nightly in named(path.read_text(encoding="utf-8")):
        there = {**DAILY, **NIGHTLY} if is_nightly else DAILY
        file = "nightly.py" if is_nightly else "noxfile.py"
        assert name in there, f"{path.relative_to(ROOT)} names the session {name}, which {file} does not have"


def test_named_finds_sessions() -> None:
    text = "`nox -s lint types`, `nox -f nightly.py -s fuzz -- x` and .venv/bin/nox -R -s tests -- -n auto"
    assert list(named(text)) == [("lint", False), ("fuzz", True), ("tests", False)]

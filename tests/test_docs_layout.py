"""Code samples fit the pages: nothing wraps in a window of 1280 pixels, and a comment can be read at 400 pixels."""

from __future__ import annotations

import ast
import io
import re
import tokenize
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import pytest

ROOT = Path(__file__).resolve().parents[1]
PAGES = [
    *(ROOT / "docs").rglob("*.md"),
    ROOT / "README.md",
    ROOT / "CONTRIBUTING.md",
    *(ROOT / "packages").glob("*/README.md"),
]
MODULES = [*(ROOT / "src").rglob("*.py"), *(ROOT / "packages").glob("*/src/**/*.py")]

#: Maximum length of a comment with its indentation.
COMMENT = 70
#: Maximum length of a line. A window of 1280 pixels shows 94 columns in the font of code samples.
LINE = 93
#: Languages of blocks that are not shown as they are written: directives.
DIRECTIVE = re.compile(r"\{")
#: Languages in which "#" begins a comment.
COMMENTED = frozenset({"python", "pycon", "sh", "bash", "toml", "yaml", "console"})
#: Comments that a program reads.
FOR_PROGRAMS = re.compile(r"# (type|noqa|doctest|fmt|pragma)\b")


class Line(NamedTuple):
    """A line of a code sample.

    Attributes:
        number: Line number in the file.
        language: Language of the block.
        code: The line, without the prompt of an interpreter.
        width: Number of columns on the page.
        is_output: Whether a program printed the line.
    """

    number: int
    language: str
    code: str
    width: int
    is_output: bool


def of_page(text: str) -> Iterator[Line]:
    """Yield the lines of the code samples of a page."""
    fence: tuple[str, str] | None = None
    for number, line in enumerate(text.splitlines(), 1):
        mark = re.match(r" *(`{3,}|~{3,}|:{3,})\s*(\S*)", line)
        if mark and fence is None and not mark[1].startswith(":"):
            fence = (mark[1], mark[2])
        elif mark and fence is not None and mark[1] == fence[0] and not mark[2]:
            fence = None
        elif fence is not None and not DIRECTIVE.match(fence[1]):
            prompt = re.match(r" *(?:>>>|\.\.\.)(?: |$)", line) if fence[1] in ("python", "pycon") else None
            is_output = fence[1] == "pycon" and prompt is None
            yield Line(number, fence[1], line[prompt.end() :] if prompt else line, len(line), is_output)


def of_docstrings(text: str) -> Iterator[Line]:
    """Yield the lines of the examples in the docstrings of a module."""
    lines = text.splitlines()
    for node in ast.walk(ast.parse(text)):
        if not isinstance(node, (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)):
            continue
        if ast.get_docstring(node) is None:
            continue
        docstring = node.body[0]
        for number in range(docstring.lineno, (docstring.end_lineno or docstring.lineno) + 1):
            prompt = re.match(r" *(?:>>>|\.\.\.) ", lines[number - 1])
            if prompt:
                # The page does not show the indentation of the module.
                width = len(lines[number - 1].strip())
                yield Line(number, "python", lines[number - 1][prompt.end() :], width, False)


def comment_of(line: Line) -> tuple[str, bool] | None:
    """Return the comment in a line, and whether the line has nothing else."""
    if line.language not in COMMENTED or line.is_output:
        return None
    if line.language not in ("python", "pycon"):
        found = re.search(r"(?:^|\s)(#(?:\s.*)?)$", line.code)
        return None if found is None else (found[1], not line.code[: found.start(1)].strip())
    try:
        for token in tokenize.generate_tokens(io.StringIO(line.code.strip()).readline):
            if token.type == tokenize.COMMENT:
                return token.string, token.start[1] == 0
    except (tokenize.TokenError, IndentationError, SyntaxError):
        # The line is a part of a statement.
        pass
    return None


def faults(line: Line, is_on_site: bool = True) -> Iterator[str]:
    """Yield what does not fit."""
    comment = comment_of(line)
    if comment is not None and not FOR_PROGRAMS.match(comment[0]):
        text, is_alone = comment
        if not is_alone:
            yield f"the comment {text!r} is behind code; write it on its own line, above the code"
        elif line.width > COMMENT:
            yield f"the comment has {line.width} columns; expected at most {COMMENT}"
    if is_on_site and line.width > LINE and not line.is_output:
        yield f"the line has {line.width} columns; expected at most {LINE}"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_code_samples_of_pages_fit(page: Path) -> None:
    # Readers of CONTRIBUTING.md insert its lines into modules, which have lines of 120 columns. The README of the
    # repository has each of its two commands on one line, so that a command can be copied as a whole.
    is_on_site = page.name != "CONTRIBUTING.md" and page != ROOT / "README.md"
    found = [
        f"{page.relative_to(ROOT)}:{line.number}: {fault}"
        for line in of_page(page.read_text(encoding="utf-8"))
        for fault in faults(line, is_on_site)
    ]
    assert not found, "\n".join(found)


def test_code_samples_of_docstrings_fit() -> None:
    found = [
        f"{module.relative_to(ROOT)}:{line.number}: {fault}"
        for module in MODULES
        for line in of_docstrings(module.read_text(encoding="utf-8"))
        for fault in faults(line)
    ]
    assert not found, "\n".join(found)


def test_each_kind_of_layout_fault_is_reported() -> None:
    page = "\n".join(
        [
            "```python",
            "q = home  # rad",
            f"# {'long' * 18}",
            "name = 'a # b'  # type: ignore",
            f"x = {'1 + ' * 25}1",
            "```",
            "```pycon",
            ">>> q = home  # rad",
            "printed # by a program",
            "```",
            "```sh",
            "pip install x   # first",
            "curl page#anchor",
            "```",
            "a # b",
        ]
    )
    found = [(line.number, fault.partition(";")[0]) for line in of_page(page) for fault in faults(line)]
    assert found == [
        (2, "the comment '# rad' is behind code"),
        (3, "the comment has 74 columns"),
        (5, "the line has 105 columns"),
        (8, "the comment '# rad' is behind code"),
        (12, "the comment '# first' is behind code"),
    ]
    module = 'def f():\n    """Do it.\n\n    >>> f()  # now\n    """\n'
    assert [(line.number, *faults(line)) for line in of_docstrings(module)] == [
        (4, "the comment '# now' is behind code; write it on its own line, above the code")
    ]

"""Notebooks of docs/notebooks/: read the cells of a page, make a notebook of them, and execute them.

A page is Markdown. Each `python` block is a cell of code. A `text` block that follows it is the output that the cell
prints, in which `...` stands for any text. An image that follows it is the plot that the cell shows. A notebook has
neither, because the reader executes it.
"""

from __future__ import annotations

import ast
import contextlib
import io
import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

__all__ = ["PAGES", "Cell", "Result", "cells_of", "execute", "notebook"]

FOLDER = Path(__file__).parent / "notebooks"
#: The pages, in the order of the course.
PAGES = [FOLDER / f"{name}.md" for name in ("read-and-plot", "move-and-stop", "test-your-cell")]

_BLOCK = re.compile(r"^```(python|text)\n(.*?)^```\n", re.MULTILINE | re.DOTALL)
_IMAGE = re.compile(r"^!\[.*?\]\((.*?)\)\n", re.MULTILINE | re.DOTALL)
_DOWNLOAD = re.compile(r"^\[Download this page as a notebook\]\(.*?\)\n", re.MULTILINE)
_DROPDOWN = re.compile(r"^:::\{dropdown\} (.*)\n", re.MULTILINE)


class Cell(NamedTuple):
    """A cell of a page.

    Attributes:
        line: Line number on the page.
        is_code: Whether it is code rather than text.
        source: Code or text of the cell.
        output: Output that the page shows; None if it shows none.
        image: File of the plot that the page shows, relative to the page; None if it shows none.
    """

    line: int
    is_code: bool
    source: str
    output: str | None = None
    image: str | None = None


class Result(NamedTuple):
    """What a cell has printed and shown.

    Attributes:
        text: Printed text, and the value of the last expression as text.
        plot: Value of the last expression if it is a plot.
    """

    text: str
    plot: Any


def cells_of(page: str) -> list[Cell]:
    """Return the cells of a page, in order."""
    cells: list[Cell] = []
    begin = 0
    for block in _BLOCK.finditer(page):
        _add_text(cells, page, begin, block.start())
        line = page.count("\n", 0, block.start()) + 1
        if block[1] == "python":
            cells.append(Cell(line, True, block[2].rstrip("\n")))
        else:
            # Output belongs to the cell of code directly above it.
            assert cells[-1].is_code, f"line {line}: output without a cell"
            cells[-1] = cells[-1]._replace(output=block[2])
        begin = block.end()
    _add_text(cells, page, begin, len(page))
    return cells


def _add_text(cells: list[Cell], page: str, begin: int, end: int) -> None:
    """Add the text between two blocks, and note its image in the cell of code above it."""
    text = page[begin:end]
    image = _IMAGE.search(text)
    if image is not None:
        assert cells[-1].is_code, "an image without a cell"
        cells[-1] = cells[-1]._replace(image=image[1])
        text = text.replace(image[0], "")
    text = _DOWNLOAD.sub("", text)
    # A notebook has no dropdowns: the solutions get a heading.
    text = _DROPDOWN.sub(r"### \1\n\n", text)
    text = re.sub(r"^:::\n", "", text, flags=re.MULTILINE)
    text = re.sub(r"\n{3,}", "\n\n", text).strip("\n")
    if text:
        cells.append(Cell(page.count("\n", 0, begin) + 1, False, text))


def notebook(page: str) -> str:
    """Return the notebook of a page as JSON, without outputs."""
    cells: list[dict[str, Any]] = []
    for number, cell in enumerate(cells_of(page)):
        made: dict[str, Any] = {
            "cell_type": "code" if cell.is_code else "markdown",
            "id": f"cell-{number}",
            "metadata": {},
            "source": cell.source.splitlines(keepends=True),
        }
        if cell.is_code:
            made |= {"execution_count": None, "outputs": []}
        else:
            # A notebook shows each line of a paragraph as it is in a web page: the window wraps it.
            made["source"] = _joined(cell.source).splitlines(keepends=True)
        cells.append(made)
    metadata = {
        "kernelspec": {"display_name": "Python 3", "language": "python", "name": "python3"},
        "language_info": {"name": "python"},
    }
    whole = {"cells": cells, "metadata": metadata, "nbformat": 4, "nbformat_minor": 5}
    return json.dumps(whole, indent=1, ensure_ascii=False) + "\n"


def _joined(text: str) -> str:
    """Join the lines of each paragraph and of each item of a list."""
    return re.sub(r"(?<=\S)\n +(?=\S)|(?<=[^\n|])\n(?=[^\n#|\-\d])", " ", text)


def execute(cells: list[Cell]) -> Iterator[tuple[Cell, Result]]:
    """Execute the cells of code in one namespace, as a kernel does, and yield their results."""
    names: dict[str, Any] = {"__name__": "__main__"}
    for cell in cells:
        if not cell.is_code:
            continue
        # Errors show the line of the page.
        tree = ast.parse("\n" * cell.line + cell.source)
        last = tree.body.pop() if isinstance(tree.body[-1], ast.Expr) else None
        value = None
        with contextlib.redirect_stdout(io.StringIO()) as printed:
            exec(compile(tree, "cell", "exec"), names)
            if isinstance(last, ast.Expr):
                value = eval(compile(ast.Expression(last.value), "cell", "eval"), names)
        is_plot = hasattr(value, "_repr_png_")
        text = printed.getvalue() + ("" if value is None or is_plot else f"{value!r}\n")
        yield cell, Result(text, value if is_plot else None)

"""The notebooks of the documentation are those of their pages, and their cells print what the pages show."""

from __future__ import annotations

import doctest
import importlib
import json
from pathlib import Path
from typing import Any

import pytest

DOCS = Path(__file__).resolve().parents[1] / "docs"
NAMES = ("read-and-plot", "move-and-stop", "test-your-cell")

pytest.importorskip("matplotlib", reason="matplotlib is not installed")


@pytest.fixture
def notebooks(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Any:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    monkeypatch.setenv("MPLBACKEND", "agg")
    monkeypatch.syspath_prepend(DOCS)
    return importlib.import_module("_notebooks")


def page(name: str) -> str:
    return (DOCS / "notebooks" / f"{name}.md").read_text(encoding="utf-8")


def check_outputs(notebooks: Any, name: str) -> None:
    """Execute the cells of a page, and compare what they print and show with the page."""
    checker = doctest.OutputChecker()
    options = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE
    for cell, result in notebooks.execute(notebooks.cells_of(page(name))):
        expected = cell.output or ""
        assert checker.check_output(expected, result.text, options), (
            f"docs/notebooks/{name}.md:{cell.line}: the cell prints {result.text!r}; the page shows {expected!r}"
        )
        assert (cell.image is None) == (result.plot is None), f"docs/notebooks/{name}.md:{cell.line}"
        if cell.image is not None:
            assert (DOCS / "notebooks" / cell.image).is_file(), "run `python docs/make_notebooks.py --plots`"
            assert result.plot._repr_png_().startswith(b"\x89PNG")


@pytest.mark.slow
@pytest.mark.simulated_time
@pytest.mark.parametrize("name", ["read-and-plot", "move-and-stop"])
def test_cells_print_the_output_of_their_page(notebooks: Any, name: str) -> None:
    check_outputs(notebooks, name)


@pytest.mark.slow
@pytest.mark.real_time
def test_simulated_time_cells_print_the_output_of_their_page(notebooks: Any) -> None:
    check_outputs(notebooks, "test-your-cell")


@pytest.mark.parametrize("name", NAMES)
def test_notebook_matches_its_page(notebooks: Any, name: str) -> None:
    path = DOCS / "notebooks" / f"{name}.ipynb"
    text = path.read_text(encoding="utf-8")
    assert text == notebooks.notebook(page(name)), "run `python docs/make_notebooks.py`"
    made = json.loads(text)
    assert made["nbformat"] == 4
    code = [cell for cell in made["cells"] if cell["cell_type"] == "code"]
    assert len(code) > 6
    # A reader of the notebook executes it.
    assert all(cell["outputs"] == [] for cell in code)
    assert "{dropdown}" not in text
    assert "Download this page" not in text


def test_every_page_is_a_notebook(notebooks: Any) -> None:
    assert [path.stem for path in notebooks.PAGES] == list(NAMES)
    found = {path.stem for path in (DOCS / "notebooks").glob("*.md")} - {"index"}
    assert found == set(NAMES)

"""The images of a terminal in the documentation show the current output of their commands."""

from __future__ import annotations

import html
import importlib
import re
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rich", reason="rich is not installed")

DOCS = Path(__file__).resolve().parents[1] / "docs"


@pytest.fixture
def folder(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(DOCS)


def lines_of(svg: str) -> list[str]:
    """Return the lines of text in the image of a terminal, without its title."""
    lines: dict[float, str] = {}
    for y, text in re.findall(r'<text [^>]*y="([\d.]+)"[^>]*clip-path[^>]*>(.*?)</text>', svg):
        lines[float(y)] = lines.get(float(y), "") + html.unescape(text).replace("\xa0", " ")
    return [lines[y].rstrip() for y in sorted(lines)]


def check(name: str, output: str, width: int) -> None:
    """Compare an image with the output of its command."""
    terminal: Any = importlib.import_module("_terminal")
    command = importlib.import_module(f"make_{name}_picture").COMMAND
    expected = [line.rstrip() for line in terminal.session(command, output, width).export_text().splitlines()]
    shown = lines_of((DOCS / "images" / f"{name}.svg").read_text(encoding="utf-8"))
    assert shown == expected, f"the image is out of date; run `python docs/make_{name}_picture.py`"


@pytest.mark.slow
@pytest.mark.real_time
def test_doctor_picture_shows_the_current_output(folder: None) -> None:
    maker: Any = importlib.import_module("make_doctor_picture")
    output = maker.report()
    assert re.search(r"^BAD +control", output, re.MULTILINE)
    assert re.search(r"^look +inputs", output, re.MULTILINE)
    check("doctor", output, importlib.import_module("_terminal").WIDTH)


def test_dissect_picture_shows_the_current_output(folder: None) -> None:
    maker: Any = importlib.import_module("make_dissect_picture")
    output = maker.printed()
    assert max(map(len, output.splitlines())) <= maker.WIDTH
    check("dissect", output, maker.WIDTH)

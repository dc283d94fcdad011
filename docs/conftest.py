"""How pytest runs the examples of these pages, and what it leaves alone in here."""

from pathlib import Path

import pytest

# Extensions need Sphinx, which the tests do without; drawings are programs.
collect_ignore = ["_extensions", "_plots", "conf.py"]
collect_ignore_glob = ["make_*.py"]


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Give each page an empty working directory, where its examples write files by relative names."""
    monkeypatch.chdir(tmp_path)

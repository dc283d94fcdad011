"""Configuration of pytest for the examples of these pages."""

from pathlib import Path

import pytest

# Extensions need Sphinx, which the tests do not install. Drawings are programs.
collect_ignore = ["_extensions", "_plots", "conf.py"]
collect_ignore_glob = ["make_*.py"]


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Give each page an empty working directory, in which its examples write files with relative names."""
    monkeypatch.chdir(tmp_path)

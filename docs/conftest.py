"""Configuration of pytest for the examples of these pages."""

from pathlib import Path

import pytest

# The extensions need Sphinx, which the tests do not install. The drawings are programs rather than tests.
collect_ignore = ["_extensions", "_plots", "conf.py"]
collect_ignore_glob = ["make_*.py"]


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Give each page an empty working directory for the files that its examples write."""
    monkeypatch.chdir(tmp_path)

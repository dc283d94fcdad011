"""The version of a checkout, of a clone without tags, and of what was packed."""

from __future__ import annotations

import importlib.util
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

SCRIPT = Path(__file__).resolve().parents[1] / "version.py"


@pytest.fixture
def version() -> Callable[[Path], str]:
    spec = importlib.util.spec_from_file_location("version", SCRIPT)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    found: Callable[[Path], str] = module.version
    return found


def git(folder: Path, *arguments: str) -> str:
    who = ["-c", "user.name=somebody", "-c", "user.email=somebody@example.com", "-c", "commit.gpgsign=false"]
    command = ["git", *who, *arguments]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, check=True).stdout.strip()


@pytest.mark.real_time
def test_the_version_is_that_of_the_newest_tag(version: Callable[[Path], str], tmp_path: Path) -> None:
    assert version(tmp_path) == "0.1.0.dev0"  # a folder that is no checkout
    git(tmp_path, "init", "-q")
    assert version(tmp_path) == "0.1.0.dev0"  # without a commit
    git(tmp_path, "commit", "-q", "--allow-empty", "-m", "one")
    assert version(tmp_path) == f"0.1.0.dev1+g{git(tmp_path, 'rev-parse', '--short', 'HEAD')}"
    git(tmp_path, "tag", "v1.9.2")
    git(tmp_path, "tag", "another")
    assert version(tmp_path) == "1.9.2"
    git(tmp_path, "commit", "-q", "--allow-empty", "-m", "two")
    assert version(tmp_path) == f"1.9.3.dev1+g{git(tmp_path, 'rev-parse', '--short', 'HEAD')}"
    (tmp_path / "folder").mkdir()
    assert version(tmp_path / "folder") == "0.1.0.dev0"  # in a checkout, and none itself
    (tmp_path / "PKG-INFO").write_text("Metadata-Version: 2.4\nName: urlink\nVersion: 7.8.9\n", encoding="utf-8")
    assert version(tmp_path) == "7.8.9"

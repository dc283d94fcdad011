"""The version of the distribution: from the newest tag, in a clone without tags, without git, and in an sdist."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("hatch_vcs", reason="hatch-vcs is not installed; the dependency group `tests` has it")

pytestmark = [pytest.mark.slow, pytest.mark.real_time]

PYPROJECT = Path(__file__).resolve().parents[1] / "pyproject.toml"


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    """Folder with the settings of the project, which is not a git repository yet."""
    shutil.copy(PYPROJECT, tmp_path)
    return tmp_path


def version(folder: Path) -> str:
    """Return the version that a build in a folder has."""
    command = [sys.executable, "-m", "hatchling", "version"]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, check=True).stdout.split()[-1]


def git(folder: Path, *arguments: str) -> str:
    who = ["-c", "user.name=somebody", "-c", "user.email=somebody@example.com", "-c", "commit.gpgsign=false"]
    command = ["git", *who, *arguments]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, check=True).stdout.strip()


def commit(folder: Path) -> str:
    """Commit the whole folder; return the commit as it appears in the version."""
    git(folder, "add", "-A")
    git(folder, "commit", "-q", "--allow-empty", "-m", "a change")
    return "g" + git(folder, "rev-parse", "--short=9", "HEAD")


def test_version_follows_the_newest_tag(checkout: Path) -> None:
    git(checkout, "init", "-q")
    commit(checkout)
    git(checkout, "tag", "v1.9.2")
    git(checkout, "tag", "another")
    assert version(checkout) == "1.9.2"
    head = commit(checkout)
    assert version(checkout) == f"1.9.3.dev1+{head}"


def test_version_counts_commits_when_no_tag_exists(checkout: Path) -> None:
    git(checkout, "init", "-q")
    head = commit(checkout)
    assert version(checkout) == f"0.1.dev1+{head}"


def test_version_is_the_fallback_without_git(checkout: Path) -> None:
    assert version(checkout) == "0.1.dev0"


def test_version_is_the_fallback_in_a_folder_of_another_checkout(checkout: Path) -> None:
    """If the project was copied into another repository, the tags there do not belong to the project."""
    git(checkout, "init", "-q")
    inner = checkout / "inner"
    inner.mkdir()
    shutil.copy(PYPROJECT, inner)
    commit(checkout)
    git(checkout, "tag", "v7.0.0")
    assert version(inner) == "0.1.dev0"


def test_version_in_an_sdist_comes_from_its_metadata(checkout: Path) -> None:
    metadata = "Metadata-Version: 2.4\nName: urlink-robot\nVersion: 7.8.9\n"
    (checkout / "PKG-INFO").write_text(metadata, encoding="utf-8")
    assert version(checkout) == "7.8.9"

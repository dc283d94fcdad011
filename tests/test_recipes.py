"""Recipes of CONTRIBUTING, each executed in a copy of the repository."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.recipes import ROOT, Edit, Recipe, recipes

#: Files and folders that a recipe may edit, import or run.
_COPIED = ("src", "docs", "tests", "captures", "conftest.py", "pyproject.toml", "CONTRIBUTING.md")
# The copies of compiled modules remain valid, except for those of edited modules, which have another date.
_IGNORED = shutil.ignore_patterns("interop", "mutants", "soak", "images")

every_recipe = pytest.mark.parametrize("recipe", recipes(), ids=lambda recipe: recipe.name)


@every_recipe
def test_recipe_steps_fit_the_repository(recipe: Recipe) -> None:
    edited: dict[str, str] = {}
    for edit in recipe.edits:
        path = ROOT / edit.path
        assert path.exists() == (edit.place != "new"), edit.path
        before = edited.get(edit.path, path.read_text(encoding="utf-8") if path.exists() else "")
        edited[edit.path] = edit.applied(before)
    assert edited, f"CONTRIBUTING.md: no step of 'Adding {recipe.name}' edits a file"


@pytest.mark.slow
@pytest.mark.real_time
@every_recipe
def test_recipe_makes_its_check_pass(recipe: Recipe, tmp_path: Path) -> None:
    copy_repository(tmp_path)
    assert python(tmp_path, "-c", recipe.check).returncode != 0, "the check passes without the steps"
    for edit in recipe.edits:
        edit.apply(tmp_path)
    for command in recipe.commands:
        done = python(tmp_path, *command)
        assert done.returncode == 0, f"python {' '.join(command)}:\n{done.stdout}{done.stderr}"
    done = python(tmp_path, "-c", recipe.check)
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.slow
@pytest.mark.real_time
@every_recipe
def test_recipe_fails_if_any_step_is_missing(recipe: Recipe, tmp_path: Path) -> None:
    """Without any one of the edits in `src`, the check fails."""
    copy_repository(tmp_path)
    kept = {edit.path: (tmp_path / edit.path) for edit in recipe.edits if edit.path.startswith("src/")}
    before = {path: file.read_text(encoding="utf-8") if file.exists() else None for path, file in kept.items()}
    for missing in recipe.edits:
        if missing.path not in before:
            continue
        for path, text in before.items():
            if text is None:
                kept[path].unlink(missing_ok=True)
            else:
                kept[path].write_text(text, encoding="utf-8")
        for edit in recipe.edits:
            if edit is not missing and edit.path in before:
                edit.apply(tmp_path)
        assert python(tmp_path, "-c", recipe.check).returncode != 0, f"the step for {missing.path} has no effect"


def copy_repository(root: Path) -> None:
    for name in _COPIED:
        if (ROOT / name).is_dir():
            shutil.copytree(ROOT / name, root / name, ignore=_IGNORED)
        else:
            shutil.copy(ROOT / name, root / name)


def python(root: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "PYTHONPATH": f"{root / 'src'}{os.pathsep}{root}", "PYTHONDONTWRITEBYTECODE": "1"}
    return subprocess.run(
        [sys.executable, *arguments],
        cwd=root,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
        timeout=240.0,
    )


@pytest.mark.parametrize("anchor", ["three", "o"])
def test_edit_rejects_a_missing_or_repeated_anchor(anchor: str) -> None:
    with pytest.raises(LookupError, match=f"lines of a.py begin with '{anchor}'; expected 1"):
        Edit("a.py", "new\n", "above", anchor).applied("one\n  other\n")

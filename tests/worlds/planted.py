"""Defects of the past, put back one at a time, and the smallest world in which each shows.

A defect is a patch in `defects/`, applied to a copy of `src` in a temporary folder. Worlds run on this copy by
``PYTHONPATH``: ``python -m tests.worlds --planted NAME`` looks for the first seed that fails, and makes its world
smaller.
"""

from __future__ import annotations

import contextlib
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path

__all__ = ["NAMES", "planted", "worlds"]

ROOT = Path(__file__).resolve().parents[2]
_PATCHES = Path(__file__).parent / "defects"
#: The names of the defects.
NAMES = tuple(sorted(path.stem for path in _PATCHES.glob("*.patch")))


@contextlib.contextmanager
def planted(name: str | None) -> Iterator[Path]:
    """A folder with `src` in which that defect is; without a name, `src` as it is.

    Raises:
        CalledProcessError: the patch does not apply any more.
    """
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder)
        shutil.copytree(ROOT / "src", root / "src", ignore=shutil.ignore_patterns("__pycache__"))
        if name is not None:
            subprocess.run(
                ["git", "apply", "--whitespace=nowarn", str(_PATCHES / f"{name}.patch")],
                cwd=root,
                check=True,
                env={**os.environ, "GIT_CEILING_DIRECTORIES": str(root.parent)},
            )
        yield root


def worlds(root: Path, arguments: Sequence[str]) -> subprocess.CompletedProcess[str]:
    """What ``python -m tests.worlds`` says with the code of that folder; its output is shown as it comes."""
    env = {**os.environ, "PYTHONPATH": str(root / "src")}
    return subprocess.run([sys.executable, "-m", "tests.worlds", *arguments], cwd=ROOT, env=env, text=True)

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
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from .scenes import SCENES
from .world import World

__all__ = ["NAMES", "SHOWN", "apply", "planted", "worlds"]

ROOT = Path(__file__).resolve().parents[2]
_PATCHES = Path(__file__).parent / "defects"
#: The names of the defects.
NAMES = tuple(sorted(path.stem for path in _PATCHES.glob("*.patch")))


#: With how many seeds a scene is tried, where not with three: which thread goes first is the seed's.
_TRIES: Mapping[str, int] = {
    "cancelled-task-moves-the-arm": 20,
    "stop-after-the-next": 40,
    "two-connections-claim-the-same": 100,
    "message-after-the-last": 400,
}
#: A small world that shows the defect, and with how many seeds it is tried.
SHOWN: Mapping[str, tuple[World, int]] = {name: (SCENES[name], _TRIES.get(name, 3)) for name in NAMES}


@contextlib.contextmanager
def planted(name: str | None) -> Iterator[Path]:
    """A folder with `src` in which that defect is; without a name, `src` as it is.

    Raises:
        CalledProcessError: the patch does not apply any more.
    """
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder)
        # With what is compiled, or each run would compile it all anew.
        shutil.copytree(ROOT / "src", root / "src")
        if name is not None:
            apply(name, root)
        yield root


def apply(name: str, root: Path, *options: str) -> None:
    """Apply a patch to the `src` in that folder, with options of ``git apply``.

    Raises:
        CalledProcessError: it does not apply any more.
    """
    subprocess.run(
        ["git", "apply", "--whitespace=nowarn", *options, str(_PATCHES / f"{name}.patch")],
        cwd=root,
        check=True,
        env={**os.environ, "GIT_CEILING_DIRECTORIES": str(root.parent)},
    )


def worlds(root: Path, arguments: Sequence[str]) -> subprocess.CompletedProcess[str]:
    """``python -m tests.worlds`` with the code of that folder, and what it prints."""
    env = {**os.environ, "PYTHONPATH": str(root / "src")}
    return subprocess.run(
        [sys.executable, "-m", "tests.worlds", *arguments], cwd=ROOT, env=env, text=True, stdout=subprocess.PIPE
    )

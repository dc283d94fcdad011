"""Where the captures of real robots and of the original programs are: beside the repository; not everybody has them.

A test that reads them is marked ``@pytest.mark.captures("ur")``, with the names of the folders it needs. Where one of
them is absent the test is skipped before it starts, so in the main thread: a skip that is raised in a thread of a
test's own fails it. ``pytest -m captures`` runs these tests alone.
"""

from __future__ import annotations

from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2] / "shared" / "captures"

#: Folder -> what is in it.
CONTENTS = {
    "ur": "packets of real controllers",
    "real": "the log of a real arm",
    "rtde": "connections of real RTDE clients",
    "rhd": "connections of the original RHD",
    "mrc": "drives of the original MRC",
}

_needed: list[str] = []


def names_in(item: pytest.Item) -> list[str]:
    """The folders that a test needs, by its marks."""
    names = [name for mark in item.iter_markers("captures") for name in mark.args]
    if unknown := set(names) - CONTENTS.keys():
        raise pytest.UsageError(f"{item.nodeid} needs captures {unknown}; there are {', '.join(CONTENTS)}")
    return names


def require(item: pytest.Item) -> None:
    """Called before each test; skips it where a folder that it needs is absent."""
    _needed[:] = names_in(item)
    for name in _needed:
        if not (ROOT / name).is_dir():
            pytest.skip(f"the captures in ../shared/captures/{name} ({CONTENTS[name]}) are not beside this repository")


def folder(name: str) -> Path:
    """The folder of that name.

    Raises:
        RuntimeError: if the test is not marked as one that needs it. It would fail where the captures are absent.
    """
    if name not in _needed:
        raise RuntimeError(f"mark the test with @pytest.mark.captures({name!r})")
    return ROOT / name

"""Captures of real robots and of the original programs, in a folder next to the repository that not everyone has.

A test that reads captures is marked ``@pytest.mark.captures("ur")``, with the names of the folders it needs. If one of
them is missing, the test is skipped before it starts, in the main thread. (A skip that is raised in another thread of
the test would make it fail.) ``pytest -m captures`` runs only these tests.
"""

from __future__ import annotations

from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2] / "shared" / "captures"

#: Contents of each folder.
CONTENTS = {
    "ur": "packets of real controllers",
    "real": "the log of a real arm",
    "rtde": "connections of real RTDE clients",
    "rhd": "connections of the original RHD",
    "mrc": "drives of the original MRC",
    "mqtt": "the traffic of a real mobile robot",
}

_needed: list[str] = []


def names_in(item: pytest.Item) -> list[str]:
    """Return the names of the folders that a test needs, according to its marks."""
    names = [name for mark in item.iter_markers("captures") for name in mark.args]
    if unknown := set(names) - CONTENTS.keys():
        raise pytest.UsageError(
            f"{item.nodeid} needs unknown captures {unknown}; expected some of {', '.join(CONTENTS)}"
        )
    return names


def require(item: pytest.Item) -> None:
    """Skip a test if a folder that it needs is missing. Called before each test."""
    _needed[:] = names_in(item)
    for name in _needed:
        if not (ROOT / name).is_dir():
            pytest.skip(f"../shared/captures/{name} ({CONTENTS[name]}) does not exist next to this repository")


def folder(name: str) -> Path:
    """Return the folder with this name.

    Raises:
        RuntimeError: If the test has no mark for this folder. Without the mark it would fail if the folder is missing.
    """
    if name not in _needed:
        raise RuntimeError(f"mark the test with @pytest.mark.captures({name!r})")
    return ROOT / name

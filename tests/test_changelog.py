"""The upgrade table of the changelog: its new names exist, and its old names do not."""

from __future__ import annotations

import importlib
import importlib.util
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

PAGE = (Path(__file__).resolve().parents[1] / "CHANGELOG.md").read_text(encoding="utf-8")
ROWS = [
    (before, now)
    for before, now in re.findall(r"(?m)^\| (.+?) \| (.+?) \|$", PAGE.partition("| Before | Now |")[2])
    if not before.startswith("---")
]
NAME = r"`((?:urlink|rhdlink|linkcore)(?:\.\w+)*)`"


def found(name: str) -> object:
    """Return a module, or an attribute of a module.

    Raises:
        ImportError, AttributeError: If it does not exist.
    """
    try:
        return importlib.import_module(name)
    except ModuleNotFoundError:
        module, _, attribute = name.rpartition(".")
        if not module:
            raise
        return getattr(found(module), attribute)


def is_module(name: str) -> bool:
    try:
        return importlib.util.find_spec(name) is not None
    except ModuleNotFoundError:  # of its parent
        return False


def moved() -> Iterator[tuple[str, str, str]]:
    """Yield the moved classes and functions: name, old module, new module."""
    for before, now in ROWS:
        target = re.match(NAME, now)
        for names, old in re.findall(rf"((?:`\w+`(?:, )?)+) in {NAME}", before):
            if target is not None:
                yield from ((name, old, target[1]) for name in re.findall(r"`(\w+)`", names))


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row[0][:40])
def test_new_names_of_the_upgrade_table_exist(row: tuple[str, str]) -> None:
    for name in re.findall(NAME, row[1]):
        # A package of its own may be missing in this environment.
        if name != "urlink.compat":
            found(name)


def test_moved_names_are_public_in_the_new_place_only() -> None:
    rows = list(moved())
    assert len(rows) > 40
    for name, old, new in rows:
        assert name in dir(found(new)), f"{new} has no {name}"
        assert name not in dir(found(old)), f"{old} still has {name}; remove it from the upgrade table"


def test_moved_modules_do_not_exist_in_the_old_place() -> None:
    modules = {
        name
        for before, _ in ROWS
        for name in re.findall(NAME, before.partition(" in `")[0])
        # The first is a separate package, and the second became a folder.
        if "." in name and name not in ("urlink.compat", "urlink.motion.servo")
    }
    assert len(modules) > 20
    assert [name for name in sorted(modules) if is_module(name)] == []


def test_first_heading_is_a_version() -> None:
    headings = re.findall(r"(?m)^## (.+)$", PAGE)
    assert re.fullmatch(r"\[Unreleased\]|\[\d+\.\d+\.\d+\] - (unreleased|\d{4}-\d\d-\d\d)", headings[0])

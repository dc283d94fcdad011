"""Plugin for pytest: shares the work of collecting ten thousand tests between the processes of one run.

In a fresh checkout, two thirds of the collection time is spent on compiling the test modules with rewritten assertions
(20 s of processor time). If all processes import the modules in the same order, each process compiles all of them.

A run that selects tests by their marks, such as ``-m "slow or captures"``, needs only the modules that use these marks.
"""

from __future__ import annotations

import contextlib
import importlib
import re
from collections.abc import Generator, Sequence
from pathlib import Path

import pytest


def in_turn(modules: Sequence[str], number: int, count: int) -> Sequence[str]:
    """Return the modules in the import order of process `number` of `count`, which starts with its own share."""
    first = len(modules) * number // count
    return [*modules[first:], *modules[:first]]


def selected_marks(expression: str) -> tuple[str, ...]:
    """Return the marks of an expression such as ``slow or captures``; empty for an expression of another form."""
    marks = tuple(expression.split(" or "))
    return marks if all(re.fullmatch(r"\w+", each) for each in marks) else ()


def may_select(config: pytest.Config, path: Path) -> bool:
    """Whether the option -m may select a test of a module."""
    marks = selected_marks(config.option.markexpr)
    return not marks or any(f"mark.{each}" in path.read_text(encoding="utf-8") for each in marks)


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    is_module = collection_path.name.startswith("test_") and collection_path.suffix == ".py"
    return True if is_module and not may_select(config, collection_path) else None


@pytest.hookimpl(tryfirst=True)
def pytest_collection(session: pytest.Session) -> None:
    """Import the test modules of the given folders in a process of pytest-xdist, starting with its own share.

    The other processes then find these modules in `__pycache__`, and this process finds theirs.
    """
    worker: dict[str, str] | None = getattr(session.config, "workerinput", None)
    if worker is None:
        return
    root, start = session.config.rootpath, session.config.invocation_params.dir
    found = {path for folder in session.config.args for path in (start / folder).rglob("test_*.py")}
    paths = sorted(path for path in found if may_select(session.config, path))
    modules = [".".join(path.relative_to(root).with_suffix("").parts) for path in paths]
    for module in in_turn(modules, int(worker["workerid"].removeprefix("gw")), int(worker["workercount"])):
        # pytest imports a module that fails or skips once more, and reports it.
        with contextlib.suppress(Exception, pytest.skip.Exception):
            importlib.import_module(module)


@pytest.hookimpl(wrapper=True)
def pytest_collect_file(file_path: Path) -> Generator[None, list[pytest.Collector], list[pytest.Collector]]:
    """Search for doctests only in modules that contain examples (28 of 800)."""
    collectors = yield
    if file_path.suffix != ".py" or ">>>" in file_path.read_text(encoding="utf-8"):
        return collectors
    return [each for each in collectors if type(each).__name__ != "DoctestModule"]

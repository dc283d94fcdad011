"""A plugin for pytest: what the processes of one run need not all do to collect the same ten thousand tests.

Two thirds of the time in which a fresh checkout collects its tests goes into compiling the test modules with their
assertions rewritten, 20 s of a processor. Processes that walk through them in the same order each compile all of them.
"""

from __future__ import annotations

import contextlib
import importlib
from collections.abc import Generator, Sequence
from pathlib import Path

import pytest


def in_turn(modules: Sequence[str], number: int, count: int) -> Sequence[str]:
    """The modules in the order in which process `number` of `count` imports them: it begins with a share of its own."""
    first = len(modules) * number // count
    return [*modules[first:], *modules[:first]]


@pytest.hookimpl(tryfirst=True)
def pytest_collection(session: pytest.Session) -> None:
    """In a process of pytest-xdist: import the test modules of the folders asked for, beginning with the own share.

    Others then find these modules in `__pycache__`, as this process does those of the others.
    """
    worker: dict[str, str] | None = getattr(session.config, "workerinput", None)
    if worker is None:
        return
    root, start = session.config.rootpath, session.config.invocation_params.dir
    paths = sorted({path for folder in session.config.args for path in (start / folder).rglob("test_*.py")})
    modules = [".".join(path.relative_to(root).with_suffix("").parts) for path in paths]
    for module in in_turn(modules, int(worker["workerid"].removeprefix("gw")), int(worker["workercount"])):
        # pytest imports one that fails or skips once more, and reports it.
        with contextlib.suppress(Exception, pytest.skip.Exception):
            importlib.import_module(module)


@pytest.hookimpl(wrapper=True)
def pytest_collect_file(file_path: Path) -> Generator[None, list[pytest.Collector], list[pytest.Collector]]:
    """Examples are looked for in modules that have some: they are 28 of 800."""
    collectors = yield
    if file_path.suffix != ".py" or ">>>" in file_path.read_text(encoding="utf-8"):
        return collectors
    return [each for each in collectors if type(each).__name__ != "DoctestModule"]

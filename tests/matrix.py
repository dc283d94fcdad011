"""A plugin for pytest: of a table of cases that are alike, `@pytest.mark.matrix(3)` tries every third row.

Each test begins with another row, so that tests which share a table try all of it between them.
`nox -f nightly.py -s fuzz` and `nox -f nightly.py -s mutants` try every row, and so does who names one.
`@pytest.mark.matrix` alone: the test itself decides.

Where a table is a product, a share that has no factor in common with its axes tries every value of each.
"""

from __future__ import annotations

import os
import zlib

import pytest

#: Profiles of hypothesis (`tests/conftest.py`) that want quick tests.
_QUICK = ("default", "ci")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    if os.environ.get("HYPOTHESIS_PROFILE", "default") not in _QUICK:
        return
    tables: dict[tuple[str, int], list[pytest.Item]] = {}
    for item in items:
        share = next((mark.args[0] for mark in item.iter_markers("matrix") if mark.args), 1)
        if share > 1 and not any(asked.endswith(item.nodeid) for asked in config.args):
            tables.setdefault((item.nodeid.partition("[")[0], share), []).append(item)
    left_out = {item for (name, share), rows in tables.items() for item in _others(name, share, rows)}
    if left_out:
        config.hook.pytest_deselected(items=list(left_out))
        items[:] = [item for item in items if item not in left_out]


def _others(name: str, share: int, rows: list[pytest.Item]) -> list[pytest.Item]:
    """The rows of a test that are left to another time."""
    first = zlib.crc32(name.encode()) % min(share, len(rows))
    return [row for number, row in enumerate(rows) if (number - first) % share]

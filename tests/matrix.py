"""Plugin for pytest: `@pytest.mark.matrix(3)` runs every third row of a table of similar cases.

Each test starts with another row, so tests that share a table try all of its rows together.
`nox -f nightly.py -s fuzz` and `nox -f nightly.py -s mutants` run every row. A row that is named in the command line
also runs. With `@pytest.mark.matrix` alone, the test itself decides, for example with `trials`.

If a table is a product of axes, choose a share without a common factor with the sizes of the axes. Then every value of
each axis is tried.
"""

from __future__ import annotations

import os
import zlib

import pytest

#: Profiles of hypothesis (`tests/conftest.py`) that want quick tests.
_QUICK = ("default", "ci")

#: Whether all drawn cases are tried, as in `nox -f nightly.py -s fuzz`.
IS_WHOLE = os.environ.get("HYPOTHESIS_PROFILE") == "fuzz"


def trials(few: int, many: int) -> int:
    """Return how many cases a test with the marker `matrix` draws: `many` in the session `fuzz`, otherwise `few`."""
    return many if IS_WHOLE else few


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
    """Return the rows of a test that are not run now."""
    first = zlib.crc32(name.encode()) % min(share, len(rows))
    return [row for number, row in enumerate(rows) if (number - first) % share]

"""Simulated time for every test of a folder or module that imports `in_simulated_time` under this name."""

from __future__ import annotations

import pytest

__all__ = ["in_simulated_time"]


@pytest.fixture(autouse=True)
def in_simulated_time(request: pytest.FixtureRequest) -> None:
    """The test and its fixtures in simulated time, unless it is marked ``real_time``."""
    if request.node.get_closest_marker("real_time") is None:
        request.getfixturevalue("simulated_time")

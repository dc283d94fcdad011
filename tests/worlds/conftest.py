"""Worlds leave what a killed client had: it is collected with the test, whose warnings are ignored."""

from __future__ import annotations

import gc
from collections.abc import Iterator

import pytest


@pytest.fixture(autouse=True)
def collects_what_killed_clients_leave() -> Iterator[None]:
    """A coroutine of theirs is closed outside of its loop, which no later test is to be told of."""
    yield
    gc.collect()

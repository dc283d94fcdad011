"""Worlds leave objects of killed clients; they are collected in the same test, which ignores their warnings."""

from __future__ import annotations

import gc
from collections.abc import Iterator

import pytest


@pytest.fixture(autouse=True)
def collects_what_killed_clients_leave() -> Iterator[None]:
    """Collect objects of killed clients: a coroutine closed outside of its loop must not warn in a later test."""
    yield
    gc.collect()

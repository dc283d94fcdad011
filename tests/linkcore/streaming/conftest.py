"""Fixtures: a scripted transport, and a stream of `Count` packets over it that is closed after the test."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from linkcore.streaming.stream import Stream
from tests.fakes.link import Count, ScriptedTransport, scripted
from tests.worlds.guarded import guards

__all__ = ["guards"]


@pytest.fixture
def transport() -> ScriptedTransport:
    return ScriptedTransport()


@pytest.fixture
def stream(transport: ScriptedTransport) -> Iterator[Stream[Count]]:
    stream = scripted(transport)
    yield stream
    stream.close()

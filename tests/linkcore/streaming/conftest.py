"""Fixtures: a scripted transport, and a stream of `Count` packets over it that is closed after the test."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from linkcore.streaming.connection import Connection
from linkcore.streaming.stream import Stream
from tests.fakes.link import Count, ScriptedTransport, connection_over
from tests.worlds.guarded import guards

__all__ = ["guards"]


@pytest.fixture
def transport() -> ScriptedTransport:
    return ScriptedTransport()


@pytest.fixture
def connection(transport: ScriptedTransport) -> Connection:
    """Connection of `stream`."""
    return connection_over(transport)


@pytest.fixture
def stream(connection: Connection) -> Iterator[Stream[Count]]:
    stream = Stream(connection, Count)
    yield stream
    stream.close()

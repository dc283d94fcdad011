"""Waiting time of a connection for the unsolicited batch, on a clock that the tests move."""

from __future__ import annotations

import pytest

import rhdlink.sync.connection
from linkcore.clock import Stamp
from linkcore.errors import LinkTimeout
from rhdlink.sync.connection import Connection
from rhdlink.variables.database import Database
from rhdlink.wire.messages import Batch, SymbolRow
from tests.fakes.clock import Clock

HANDSHAKE = Database([SymbolRow("tick", 1)]).encode_handshake("r")
BATCH = b"dr\0\0\0\0ee"


class Wire:
    """Transport whose peer sends data at given times, with the clock for it."""

    name = "wire"

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.clock = Clock(0.0)
        self.coming: list[tuple[float, bytes]] = [(0.0, HANDSHAKE)]
        self.requests = 0
        self.clock.replace(rhdlink.sync.connection, monkeypatch)

    def open(self, timeout: float) -> None: ...

    def abort(self) -> None: ...

    def close(self) -> None: ...

    def send(self, data: bytes, timeout: float) -> None:
        self.requests += data == b"rree"

    def receive(self, timeout: float | None = None) -> tuple[bytes, Stamp]:
        assert timeout is not None
        end = self.clock.now + timeout
        if self.coming and self.coming[0][0] <= end:
            at, data = self.coming.pop(0)
            self.clock.now = max(self.clock.now, at)
            return data, Stamp.now()
        self.clock.now = end
        raise LinkTimeout("nothing came")

    def receive_waiting(self) -> tuple[bytes, Stamp] | None:
        if self.coming and self.coming[0][0] <= self.clock.now:
            return self.coming.pop(0)[1], Stamp.now()
        return None


class Client:
    """Client that syncs in the same way as `Variables`."""

    def __init__(self, wire: Wire) -> None:
        self.wire = wire
        self.batches: list[Batch] = []
        self.connection = Connection(
            wire,
            access="r",
            fallback=None,
            width=None,
            limits=None,
            until=wire.clock.now + 1.0,
            deliver=self.batches.append,
        )

    def sync(self, period: float | None, timeout: float = 1.0) -> float:
        """Sync once and return how many seconds the connection waited before the request."""
        began = self.wire.clock.now
        until = began + timeout
        self.connection.take_waiting(until)
        self.connection.collect(until)
        self.connection.settle(period, until)
        waited = self.wire.clock.now - began
        self.wire.coming.append((self.wire.clock.now, BATCH))
        self.connection.request(b"", until)
        return waited


@pytest.fixture
def wire(monkeypatch: pytest.MonkeyPatch) -> Wire:
    return Wire(monkeypatch)


@pytest.mark.parametrize(
    ("period", "seconds"),
    [
        (None, 0.1),  # four ticks of the slowest known robot
        (0.01, 0.017),  # a tick and a half, plus the delay of a busy machine
        (0.025, 0.0395),
        (1.0, 0.1),  # a robot that ticks once per second must not delay each connection that long
    ],
)
def test_connection_waits_a_period_once_after_the_first_reply(wire: Wire, period: float | None, seconds: float) -> None:
    client = Client(wire)
    assert client.sync(None) == 0.0
    assert client.sync(period) == pytest.approx(seconds)
    assert client.sync(period) == 0.0
    assert (wire.requests, len(client.batches)) == (3, 3)


def test_wait_after_the_first_reply_ends_when_a_batch_arrives(wire: Wire) -> None:
    """The first reply was the unsolicited batch; the real reply follows one tick later, and later syncs do not wait."""
    client = Client(wire)
    client.sync(None)
    wire.coming = [(wire.clock.now + 0.012, BATCH)]
    assert client.sync(0.01) == pytest.approx(0.012)
    assert client.sync(0.01) == 0.0
    assert (wire.requests, len(client.batches)) == (3, 4)


def test_sync_does_not_wait_if_a_batch_came_before_the_request(wire: Wire) -> None:
    client = Client(wire)
    wire.coming = [(0.0, BATCH)]
    assert client.sync(None) == 0.0
    assert client.sync(None) == 0.0
    assert (wire.requests, len(client.batches)) == (2, 3)


def test_wait_after_the_first_reply_resumes_in_the_next_sync(wire: Wire) -> None:
    client = Client(wire)
    client.sync(None)
    with pytest.raises(LinkTimeout):
        client.sync(0.01, timeout=0.005)
    wire.coming.clear()
    client.connection._outstanding = 0
    assert client.sync(0.01) == pytest.approx(0.017)
    assert client.sync(0.01) == 0.0

"""Small guarantees of the client, each of which would break if a statement were missing or came too late."""

from __future__ import annotations

import asyncio
import gc
import weakref
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import pytest

import rhdlink
from linkcore import clock
from linkcore.streaming.connection_life import ConnectionState
from linkcore.streaming.packet_queue import PacketQueue, drop_oldest
from rhdlink.host.plugins.turtle import Turtle
from rhdlink.sync.replica import Replica
from rhdlink.sync.sync_thread import Subscribers
from rhdlink.variables.database import Database
from rhdlink.wire.messages import Batch, SymbolRow
from tests.contended import Contended, beside

pytestmark = pytest.mark.simulated_time


@pytest.fixture
def host() -> Iterator[rhdlink.Host]:
    with rhdlink.Host([Turtle()], port=0) as host:
        yield host


def test_wrong_name_is_reported_before_missing_access(host: rhdlink.Host) -> None:
    with rhdlink.connect(host.address) as robot, pytest.raises(rhdlink.NotThere):
        robot["nonsense"] = 1


def test_closed_subscription_gets_nothing_more(host: rhdlink.Host) -> None:
    updates: list[object] = []
    with rhdlink.connect(host.address) as robot:
        subscription = robot.subscribe(updates.append)
        robot.sync()
        subscription.close()
        count = len(updates)
        robot.sync()
        closed = weakref.ref(subscription)
        del subscription
        gc.collect()
        assert closed() is None
    assert len(updates) == count


def test_asyncio_robot_is_closed_before_its_connection(host: rhdlink.Host, monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[bool] = []

    async def run() -> None:
        async with rhdlink.connect_async(host.address) as robot:
            close = robot.variables.close

            def noting(timeout: float = 2.0) -> None:
                seen.append(robot._is_closed)
                close(timeout)

            monkeypatch.setattr(robot.variables, "close", noting, raising=False)

    asyncio.run(run())
    assert seen[0] is True


# -- between two threads -------------------------------------------------------------------


@pytest.fixture
def replica() -> Replica:
    """Replica of a robot with two variables in each direction; `adopt_reversed` changes their order."""
    replica = Replica("robot", "send", rhdlink.Variables)
    with replica.lock:
        replica.adopt(tables("a", "b"))
    replica.database.read.set(0, 1)
    replica.database.read.set(1, 2)
    return replica


def tables(*names: str) -> Database:
    rows = [SymbolRow(name, 1) for name in names]
    return Database(rows, rows)


def adopt_reversed(replica: Replica) -> None:
    """Simulate a new connection to a robot whose variables have the reverse order."""
    database = tables("b", "a")
    database.read.set(0, 2)
    database.read.set(1, 1)
    with replica.lock:
        replica.adopt(database)


def test_value_belongs_to_its_name_after_a_reordering(host: rhdlink.Host, replica: Replica) -> None:
    with rhdlink.connect(host.address) as robot:
        robot._replica = replica
        lock = replica.lock
        replica.lock = Contended(lock, before=lambda: adopt_reversed(replica))  # type: ignore[assignment]
        replica.database.read.set(0, -1)
        assert robot["a"] == 1


def test_request_uses_the_ids_of_its_connection(replica: Replica) -> None:
    replica.set("a", 7)
    lock = replica.lock
    replica.lock = Contended(lock, before=lambda: adopt_reversed(replica))  # type: ignore[assignment]
    assert replica.outgoing("w", 2) != b""
    assert replica._unanswered.tolist() == [replica.database.write.find("a")]


def test_flags_of_a_batch_stay_until_the_next_is_applied(replica: Replica) -> None:
    seen: list[bool] = []
    replica.begin_round()
    updated = replica.database.read.updated
    replica.database.read._received.append(np.array([0]))
    lock = replica.lock
    replica.lock = Contended(lock, before=lambda: seen.append(bool(updated[0])))  # type: ignore[assignment]
    replica.apply(Batch((), 0))
    assert seen == [True]
    assert not updated[0]


def test_subscriber_queue_is_filled_by_one_thread_at_a_time(monkeypatch: pytest.MonkeyPatch) -> None:
    inside, most = [0], [0]
    threads: list[Any] = []
    subscribers = Subscribers("robot")
    offer = PacketQueue.offer

    def noting(queue: PacketQueue, packets: Sequence[object]) -> None:
        inside[0] += 1
        most[0] = max(most[0], inside[0])
        if not threads:
            threads.append(None)
            threads[0] = beside(lambda: subscribers.tell("another"))
        offer(queue, packets)
        inside[0] -= 1

    monkeypatch.setattr(PacketQueue, "offer", noting)
    subscribers.subscribe(str, lambda event: None, None, drop_oldest(8), owner=None)
    subscribers.tell("one")
    threads[0].join()
    subscribers.close(clock.now() + 1.0)
    assert most == [1]


def test_connection_is_stored_before_it_is_reported(host: rhdlink.Host, monkeypatch: pytest.MonkeyPatch) -> None:
    with rhdlink.connect(host.address) as robot:
        seen: list[bool] = []
        tell = Subscribers.tell

        def noting(subscribers: Subscribers, event: object) -> None:
            if getattr(event, "state", None) is ConnectionState.CONNECTED:
                seen.append(robot._connection is not None)
            tell(subscribers, event)

        monkeypatch.setattr(Subscribers, "tell", noting)
        robot._lose(robot._replica, rhdlink.ConnectionLost("cut"))
        robot.sync()
        assert seen == [True]

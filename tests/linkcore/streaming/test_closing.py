"""Closing streams, subscriptions and queues: it leaves no queued packets, and ends every wait."""

from __future__ import annotations

import threading
import time
from queue import SimpleQueue

import pytest

from linkcore.errors import BadValue, Closed, ConnectionLost, LinkTimeout
from linkcore.streaming import packet_queue
from linkcore.streaming.connection import Connection
from linkcore.streaming.connection_life import Backoff, ConnectionEvent, ConnectionState
from linkcore.streaming.fanout import FanOut
from linkcore.streaming.packet_queue import PacketQueue, drop_oldest
from linkcore.streaming.stream import Stream
from tests.contended import beside, contended_lock
from tests.fakes.link import Count, CountProtocol, ScriptedTransport, connection_over, counts, scripted
from tests.waiting import until

pytestmark = pytest.mark.simulated_time

#: Time limit for events, in s, even on a busy machine.
_SOON = 20.0


class Recorded(ScriptedTransport):
    """Scripted transport that counts aborts, and can block `open`."""

    def __init__(self, *openings: Exception | None) -> None:
        super().__init__(*openings)
        self.aborts = 0
        self.may_open = threading.Event()
        self.may_open.set()

    def abort(self) -> None:
        self.aborts += 1
        super().abort()

    def open(self, timeout: float) -> None:
        self.may_open.wait(_SOON)
        super().open(timeout)


@pytest.mark.usefixtures("stream")
def test_closed_queue_drops_its_packets(connection: Connection, transport: ScriptedTransport) -> None:
    queue: PacketQueue = connection.open_queue(Count, drop_oldest(8))
    transport.put(counts(1, 2, 3))
    until(lambda: queue.waiting == 3)
    connection.close_queue(queue)
    assert (queue.is_over, queue.waiting, queue.dropped) == (True, 0, 3)


def test_lost_connection_is_aborted() -> None:
    transport = Recorded()
    stream = scripted(transport, backoff=Backoff(first=30.0, most=30.0))
    stream.start()
    transport.put(ConnectionLost("cut"))
    until(lambda: stream.connection is not ConnectionState.CONNECTED)
    until(lambda: transport.aborts >= 1)
    stream.close()


def test_close_ends_a_stream_that_waits_to_reconnect() -> None:
    transport = ScriptedTransport(None, ConnectionLost("again"))
    connection = connection_over(transport, backoff=Backoff(first=30.0, most=30.0))
    stream = Stream(connection, Count)
    states: list[ConnectionState] = []
    stream.subscribe(lambda event: states.append(event.state), kind=ConnectionEvent)
    stream.start()
    transport.put(ConnectionLost("cut"))
    until(lambda: ConnectionState.LOST in states)
    stream.close()
    assert stream.join(1.0)
    assert (connection.state, connection.is_running) == (ConnectionState.CLOSED, False)


def test_close_during_the_start_of_a_stream_raises_closed() -> None:
    """A signal handler might close the stream before the start is recorded."""
    connection = Connection("script", ScriptedTransport(), CountProtocol, FanOut(Count), timeout=0.1)
    with pytest.raises(Closed, match="script was closed"):
        connection.start(connection.abandon)


def test_start_times_out_when_the_transport_hangs() -> None:
    transport = Recorded()
    transport.may_open.clear()
    connection = Connection("script", transport, CountProtocol, FanOut(Count), timeout=0.1)
    stream = Stream(connection, Count)
    try:
        with pytest.raises(LinkTimeout, match="no connection"):
            stream.start()
    finally:
        transport.may_open.set()
        stream.close()


def test_join_ends_in_time_when_a_callback_hangs(
    stream: Stream[Count], connection: Connection, transport: ScriptedTransport
) -> None:
    entered, leave = threading.Event(), threading.Event()

    def hang(count: Count) -> None:
        entered.set()
        leave.wait(_SOON)

    stream.subscribe(hang)
    transport.put(counts(1))
    assert entered.wait(_SOON)
    connection.abandon()
    until(lambda: not connection.is_running)
    begun = time.monotonic()
    assert not stream.join(0.05)
    stream.close(0.05)
    assert time.monotonic() - begun < 1.0
    leave.set()


def test_closed_subscription_has_no_callback_running(stream: Stream[Count], transport: ScriptedTransport) -> None:
    entered, left = threading.Event(), threading.Event()

    def callback(count: Count) -> None:
        entered.set()
        time.sleep(0.1)
        left.set()

    subscription = stream.subscribe(callback)
    transport.put(counts(1))
    assert entered.wait(_SOON)
    subscription.close(_SOON)
    assert left.is_set()


def test_inline_subscription_closes_immediately(stream: Stream[Count], transport: ScriptedTransport) -> None:
    subscription = stream.subscribe(lambda count: None, inline=True)
    transport.put(counts(1))
    begun = time.monotonic()
    subscription.close(5.0)
    assert time.monotonic() - begun < 1.0


def test_finish_with_invalid_timeout_keeps_the_subscription(
    stream: Stream[Count], transport: ScriptedTransport
) -> None:
    came = threading.Event()
    subscription = stream.subscribe(lambda count: came.set())
    with pytest.raises(BadValue):
        subscription.finish(-1.0)
    transport.put(counts(1))
    assert came.wait(_SOON)


def test_connection_calls_subscribers_without_holding_its_lock(
    stream: Stream[Count], connection: Connection, transport: ScriptedTransport
) -> None:
    """Another thread can use the connection meanwhile."""
    blocked: list[bool] = []
    stream.start()
    connection.subscribe_inline(
        ConnectionEvent, lambda event: blocked.append(beside(connection.start, _SOON).is_alive())
    )
    transport.put(ConnectionLost("cut"))
    until(lambda: len(blocked) == 3)
    assert blocked == [False] * 3


def test_queue_is_marked_ended_before_the_end_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    queue = PacketQueue(drop_oldest(2))
    seen: list[bool] = []
    monkeypatch.setattr(queue, "end", lambda: seen.append(queue.is_over))
    queue.close()
    assert seen == [True]


# -- between two threads ---------------------------------------------------------------------


class Quick:
    """Tokens for a consumer that takes its packet, and sleeps again, before the call of `put` returns."""

    def __init__(self) -> None:
        self._tokens: SimpleQueue[None] = SimpleQueue()
        self.put_count = self.get_count = 0
        self.is_used = True

    def put(self, item: None) -> None:
        self.put_count += 1
        before = self.get_count
        self._tokens.put(item)
        until(lambda: self.get_count > before or not self.is_used)

    def get(self, block: bool = True, timeout: float | None = None) -> None:
        self.get_count += 1
        self._tokens.get(block, timeout)


def test_consumer_is_woken_for_each_packet_after_each_sleep(monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[Quick] = []

    def make() -> Quick:
        made.append(Quick())
        return made[-1]

    monkeypatch.setattr(packet_queue, "SimpleQueue", make)
    queue = PacketQueue(drop_oldest(8))
    to_consumer, _ = made
    consumer = threading.Thread(target=lambda: [queue.next(_SOON) for _ in range(4)])
    consumer.start()
    until(lambda: to_consumer.get_count == 1)
    for number in range(3):
        queue.offer((number,))
    assert to_consumer.put_count == 3
    to_consumer.is_used = False
    queue.end()
    consumer.join()


def test_send_timeout_starts_after_connecting() -> None:
    class Slow(ScriptedTransport):
        def open(self, timeout: float) -> None:
            time.sleep(1.0)
            super().open(timeout)
            self.room = 0

    transport = Slow()
    connection = connection_over(transport)
    waits: list[float] = []

    def wait_for_room(timeout: float) -> bool:
        waits.append(timeout)
        return False

    connection.wait_for_room = wait_for_room  # type: ignore[method-assign]
    with pytest.raises(LinkTimeout):
        connection.send(b"1234", 0.5)
    assert waits == pytest.approx([0.5], abs=0.01)
    connection.close(2.0)


def test_queue_added_just_before_a_stream_ends_is_ended() -> None:
    queue = PacketQueue(drop_oldest(8))
    with contended_lock(before=lambda: fan_out.add(queue, Count)):
        fan_out = FanOut(Count)
    fan_out.end()
    assert queue.next(0.0) is None
    assert queue.is_over

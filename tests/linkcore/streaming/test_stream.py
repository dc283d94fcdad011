"""Streams: the reader thread, subscribers, reconnections, and counters that add up."""

from __future__ import annotations

import logging
import threading
from collections.abc import Iterator

import pytest

import linkcore.clock
from linkcore.errors import BadValue, Closed, ConnectFailed, ConnectionLost, LinkTimeout
from linkcore.net.transport import Finished
from linkcore.streaming.connection import Connection
from linkcore.streaming.connection_life import Backoff, Chunk, ConnectionEvent, ConnectionState, Traffic
from linkcore.streaming.packet_queue import Policy, block, drop_oldest, latest
from linkcore.streaming.stream import Stream
from tests.fakes.link import BAD, Count, ScriptedTransport, connection_over, counts, scripted
from tests.waiting import until

pytestmark = pytest.mark.simulated_time


@pytest.fixture
def stream(connection: Connection) -> Iterator[Stream[Count]]:
    stream = Stream(connection, Count)
    yield stream
    stream.close()
    adds_up(stream)


def own_threads() -> list[str]:
    return [thread.name for thread in threading.enumerate() if thread.name.startswith("script")]


def adds_up(stream: Stream[Count]) -> None:
    stats = stream.stats
    assert stats.received == stats.decoded + stats.failed


def test_unused_stream_does_not_connect(stream: Stream[Count], transport: ScriptedTransport) -> None:
    assert transport.opened == 0
    assert stream.connection is ConnectionState.IDLE
    assert not own_threads()


def test_packets_are_delivered_in_order(stream: Stream[Count], transport: ScriptedTransport) -> None:
    got: list[int] = []
    subscription = stream.subscribe(lambda count: got.append(count.number), policy=block)
    transport.put(counts(1, 2), counts(3), Finished())
    assert stream.join(10)
    assert got == [1, 2, 3]
    assert subscription.stats.delivered == subscription.stats.offered == 3
    assert (stream.stats.received, stream.stats.decoded) == (3, 3)
    assert stream.stats.bytes == 15


def test_stamp_is_the_arrival_time(stream: Stream[Count], transport: ScriptedTransport) -> None:
    before = linkcore.clock.now()
    transport.put(counts(1))
    count = stream.wait(10)
    assert count.received is not None
    assert before <= count.received.monotonic <= linkcore.clock.now()
    assert count.received.age >= 0


def test_raising_callback_does_not_affect_others(
    stream: Stream[Count], transport: ScriptedTransport, caplog: pytest.LogCaptureFixture
) -> None:
    got: list[int] = []

    def fail(count: Count) -> None:
        raise RuntimeError("on purpose")

    failing = stream.subscribe(fail, policy=block)
    stream.subscribe(lambda count: got.append(count.number), policy=block)
    transport.put(counts(*range(9)), Finished())
    assert stream.join(10)
    assert got == list(range(9))
    assert failing.stats.raised == 9
    assert stream.stats.failed == 0
    # Errors are logged at powers of two (1, 2, 4, 8), not for each packet.
    assert sum("raised" in record.message for record in caplog.records) == 4


def test_sleeping_callback_does_not_affect_others(stream: Stream[Count], transport: ScriptedTransport) -> None:
    wake, asleep = threading.Event(), threading.Event()
    got: list[int] = []

    def sleep(count: Count) -> None:
        asleep.set()
        assert wake.wait(10)

    sleeping = stream.subscribe(sleep, policy=drop_oldest(4))
    stream.subscribe(lambda count: got.append(count.number), policy=block)
    transport.put(counts(0))
    assert asleep.wait(10)
    transport.put(counts(*range(1, 100)))
    until(lambda: len(got) == 100)
    assert sleeping.stats.dropped == 95
    assert sleeping.stats.waiting == 5  # four in the queue, one in the callback
    wake.set()
    transport.put(Finished())
    assert stream.join(10)
    assert sleeping.stats.delivered == 5
    assert (stream.stats.decoded, sleeping.stats.offered) == (100, 100)


def test_latest_policy_keeps_the_newest(stream: Stream[Count], transport: ScriptedTransport) -> None:
    wake, asleep = threading.Event(), threading.Event()
    got: list[int] = []

    def keep(count: Count) -> None:
        got.append(count.number)
        asleep.set()
        assert wake.wait(10)

    stream.subscribe(keep, policy=latest)
    transport.put(counts(0))
    assert asleep.wait(10)
    transport.put(*(counts(number) for number in range(1, 50)))
    until(lambda: stream.stats.received == 50)
    wake.set()
    transport.put(Finished())
    assert stream.join(10)
    assert got == [0, 49]


def test_block_policy_makes_the_reader_wait_and_drops_nothing(
    stream: Stream[Count], transport: ScriptedTransport
) -> None:
    gate = threading.Semaphore(0)
    got: list[int] = []

    def slow(count: Count) -> None:
        assert gate.acquire(timeout=10)
        got.append(count.number)

    subscription = stream.subscribe(slow, policy=Policy(3, drop=None))
    transport.put(counts(*range(20)), counts(20), Finished())
    for _ in range(21):
        gate.release()
    assert stream.join(10)
    assert got == list(range(21))
    assert subscription.stats.dropped == 0


def test_close_ends_a_reader_waiting_for_room(stream: Stream[Count], transport: ScriptedTransport) -> None:
    wake, asleep = threading.Event(), threading.Event()

    def sleep(count: Count) -> None:
        asleep.set()
        wake.wait(10)

    stream.subscribe(sleep, policy=Policy(1, drop=None))
    transport.put(counts(*range(50)))
    assert asleep.wait(10)
    began = linkcore.clock.now()
    stream.close(timeout=0.5)
    assert linkcore.clock.now() - began < 5
    wake.set()
    until(lambda: not own_threads())
    adds_up(stream)


def test_callback_can_close_the_stream(stream: Stream[Count], transport: ScriptedTransport) -> None:
    closed = threading.Event()

    def close(count: Count) -> None:
        stream.close()
        stream.close()
        closed.set()

    stream.subscribe(close)
    transport.put(counts(1, 2, 3))
    assert closed.wait(10)
    until(lambda: not own_threads())
    assert stream.connection is ConnectionState.CLOSED


def test_callback_can_close_its_subscription(stream: Stream[Count], transport: ScriptedTransport) -> None:
    got: list[int] = []

    def once(count: Count) -> None:
        got.append(count.number)
        subscription.close()

    ready = threading.Event()

    def wait_until_ready(count: Count) -> None:
        assert ready.wait(10)
        once(count)

    subscription = stream.subscribe(wait_until_ready, policy=block)
    ready.set()
    transport.put(counts(1, 2, 3), Finished())
    assert stream.join(10)
    assert got == [1]
    stats = subscription.stats
    assert stats.offered == stats.delivered + stats.dropped
    assert stats.waiting == 0


def test_bad_packets_are_counted_without_ending_the_stream(
    stream: Stream[Count], transport: ScriptedTransport, caplog: pytest.LogCaptureFixture
) -> None:
    got: list[int] = []
    stream.subscribe(lambda count: got.append(count.number), policy=block)
    transport.put(counts(1, BAD, 2), counts(BAD), counts(3), Finished())
    assert stream.join(10)
    assert got == [1, 2, 3]
    assert (stream.stats.received, stream.stats.failed, stream.stats.decoded) == (5, 2, 3)
    assert "bad on purpose" in caplog.text


def test_skipped_bytes_are_counted_across_connections(stream: Stream[Count], transport: ScriptedTransport) -> None:
    got: list[int] = []
    stream.subscribe(lambda count: got.append(count.number), policy=block)
    transport.put(b"xxx" + counts(1) + b"\x05\x00", ConnectionLost("cut"), b"yy" + counts(2), Finished())
    assert stream.join(10)
    assert got == [1, 2]
    # Three bytes before the first packet, two of the packet that the loss cut, and two after it.
    assert stream.stats.skipped == 7
    assert stream.stats.resyncs == 2
    assert stream.stats.reconnects == 1


def test_subscriptions_survive_a_reconnect(stream: Stream[Count], transport: ScriptedTransport) -> None:
    got: list[int] = []
    events: list[ConnectionEvent] = []
    stream.subscribe(events.append, ConnectionEvent)
    stream.subscribe(lambda count: got.append(count.number), policy=block)
    cause = ConnectionLost("cable")
    transport.put(counts(1), cause, counts(2), Finished())
    assert stream.join(10)
    assert got == [1, 2]
    assert stream.stats.reconnects == 1
    states = [event.state for event in events]
    assert states[-5:] == [
        ConnectionState.CONNECTED,
        ConnectionState.LOST,
        ConnectionState.CONNECTING,
        ConnectionState.CONNECTED,
        ConnectionState.CLOSED,
    ]
    lost = [event.error for event in events if event.state is ConnectionState.LOST]
    assert [(type(error), str(error)) for error in lost] == [(ConnectionLost, str(cause))]


def test_latest_is_none_after_a_lost_connection() -> None:
    transport = ScriptedTransport()
    stream = scripted(transport, backoff=Backoff(first=60, most=60))
    transport.put(counts(7))
    assert stream.wait(10).number == 7
    assert [stream.latest] == [Count(number=7)]
    transport.put(ConnectionLost("cut"))
    until(lambda: stream.connection is ConnectionState.LOST)
    assert [stream.latest] == [None]
    assert stream.stats.age is not None
    stream.close()


def test_latest_does_not_wait_for_a_connection() -> None:
    release = threading.Event()

    class Slow(ScriptedTransport):
        def open(self, timeout: float) -> None:
            assert release.wait(10)
            super().open(timeout)

    transport = Slow()
    stream = scripted(transport)
    assert stream.latest is None
    release.set()
    transport.put(counts(3))
    until(lambda: stream.latest is not None)
    stream.close()
    assert stream.latest is None


def test_failed_first_connection_raises_immediately() -> None:
    transport = ScriptedTransport(ConnectFailed("refused"), ConnectFailed("refused"))
    stream = scripted(transport)
    with pytest.raises(ConnectFailed, match="refused"):
        stream.subscribe(print)
    with pytest.raises(ConnectFailed, match="refused"):
        stream.wait(1)
    # The third attempt succeeds, and the failures have no further effect.
    transport.put(counts(1))
    assert stream.wait(10).number == 1
    stream.close()


def test_iteration_raises_after_the_last_try_of_the_backoff() -> None:
    gone = ConnectFailed("gone")
    transport = ScriptedTransport(None, gone, gone, gone)
    stream = scripted(transport, backoff=Backoff(0, 1, 0, 0, tries=3))
    transport.put(counts(1), ConnectionLost("cut"))
    iterator = iter(stream)
    assert next(iterator).number == 1
    with pytest.raises(ConnectFailed, match="gone"):
        next(iterator)
    assert transport.opened == 4
    stream.close()


def test_backoff_restarts_only_after_a_packet() -> None:
    """Connections without a packet use up the tries; a connection with a packet restores them."""
    transport = ScriptedTransport()
    stream = scripted(transport, backoff=Backoff(0, 1, 0, 0, tries=2))
    cut = ConnectionLost("cut")
    transport.put(counts(1), cut, cut, counts(2), cut, cut, counts(3), cut, cut, cut)
    got: list[int] = []
    stream.subscribe(lambda count: got.append(count.number), policy=block)
    stream.join(10)
    assert got == [1, 2, 3]
    assert repr(stream.failure) == repr(cut)
    stream.close()


def test_deadline_is_reported_once_for_each_silence(stream: Stream[Count], transport: ScriptedTransport) -> None:
    late = threading.Event()
    ages: list[float] = []

    def on_deadline(age: float) -> None:
        ages.append(age)
        late.set()

    subscription = stream.subscribe(lambda count: None, deadline=0.02, on_deadline=on_deadline)
    assert late.wait(10)
    late.clear()
    # The deadline is reported once for each silence; only a packet arms it again.
    transport.put(counts(1))
    assert late.wait(10)
    assert subscription.stats.missed_deadlines == len(ages) == 2
    assert all(age >= 0.02 for age in ages)


def test_error_in_on_deadline_is_logged_only(
    stream: Stream[Count], transport: ScriptedTransport, caplog: pytest.LogCaptureFixture
) -> None:
    got = threading.Event()

    def fail(age: float) -> None:
        raise RuntimeError("on purpose")

    subscription = stream.subscribe(lambda count: got.set(), deadline=0.01, on_deadline=fail)
    until(lambda: subscription.stats.missed_deadlines == 1)
    transport.put(counts(1))
    assert got.wait(10)
    assert "on_deadline" in caplog.text


def test_wait_raises_failed_connection_although_retry_has_begun(monkeypatch: pytest.MonkeyPatch) -> None:
    transport = ScriptedTransport(ConnectFailed("refused"), None)
    connection = connection_over(transport)
    stream = Stream(connection, Count)
    settle = connection._settle

    def with_another_try() -> None:
        settle()
        monkeypatch.setattr(connection, "_settle", settle)
        connection._begin(is_patient=True)  # as `latest` in another thread does, before the waiting thread wakes up

    monkeypatch.setattr(connection, "_settle", with_another_try)
    with pytest.raises(ConnectFailed, match="refused"):
        stream.subscribe(lambda count: None)
    until(lambda: stream.connection is ConnectionState.CONNECTED)
    stream.close()


def test_missed_deadline_without_callback_is_logged(stream: Stream[Count], caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.WARNING):
        subscription = stream.subscribe(lambda count: None, deadline=0.01)
        until(lambda: "nothing was received for" in caplog.text)
    assert subscription.stats.missed_deadlines == 1


def test_bytes_without_packets_count_as_silence() -> None:
    transport = ScriptedTransport()
    stream = scripted(transport, backoff=Backoff(tries=0), silence=0.02)
    stop = threading.Event()

    def babble() -> None:
        while not stop.wait(0.002):
            transport.put(b"x")

    babbler = threading.Thread(target=babble)
    babbler.start()
    with pytest.raises(LinkTimeout, match="no complete packet"):
        next(iter(stream))
    stop.set()
    babbler.join()
    stream.close()


def test_iteration_ends_when_the_stream_is_closed(stream: Stream[Count], transport: ScriptedTransport) -> None:
    transport.put(counts(1))
    seen = []
    for count in stream:
        seen.append(count.number)
        stream.close()
    assert seen == [1]
    with pytest.raises(Closed):
        next(iter(stream))


def test_closed_iteration_removes_its_queue(
    stream: Stream[Count], connection: Connection, transport: ScriptedTransport
) -> None:
    transport.put(counts(1))
    iterator = stream.iterate(drop_oldest(8))
    assert next(iterator).number == 1
    assert len(list(connection.fan_out.sinks)) == 1
    iterator.close()  # type: ignore[attr-defined]
    assert connection.fan_out.sinks == ()


def test_ended_stream_ends_new_iterations_immediately(stream: Stream[Count], transport: ScriptedTransport) -> None:
    transport.put(counts(1), Finished())
    assert [count.number for count in stream.iterate(block)] == [1]
    assert list(stream) == []
    with pytest.raises(Closed):
        stream.wait(5)


def test_wait_times_out(stream: Stream[Count]) -> None:
    with pytest.raises(LinkTimeout, match=r"no Count from script within 0\.01 s"):
        stream.wait(0.01)
    with pytest.raises(TimeoutError):
        stream.wait(0.01)


def test_wait_returns_only_later_packets(stream: Stream[Count], transport: ScriptedTransport) -> None:
    transport.put(counts(1))
    assert stream.wait(10).number == 1
    with pytest.raises(LinkTimeout):
        stream.wait(0.01)


def test_traffic_subscription_gets_every_byte_and_event_in_order(
    stream: Stream[Count], transport: ScriptedTransport
) -> None:
    seen: list[Chunk | ConnectionEvent] = []
    stream.subscribe(seen.append, Traffic, policy=block)
    pieces = [counts(1)[:3], counts(1)[3:] + counts(2), b"junk"]
    transport.put(*pieces, ConnectionLost("cut"), counts(3), Finished())
    assert stream.join(10)
    assert [item.data for item in seen if isinstance(item, Chunk)] == [*pieces, counts(3)]
    lost = next(n for n, item in enumerate(seen) if isinstance(item, ConnectionEvent) and item.state.value == "lost")
    assert [item.data for item in seen[:lost] if isinstance(item, Chunk)] == pieces


def test_traffic_includes_the_start_of_a_partial_packet(stream: Stream[Count], transport: ScriptedTransport) -> None:
    packet = counts(0x01020304)
    transport.put(counts(1) + packet[:2])
    assert stream.wait(10).number == 1
    seen: list[Chunk | ConnectionEvent] = []
    stream.subscribe(seen.append, Traffic, policy=block)
    transport.put(packet[2:], Finished())
    assert stream.join(10)
    assert b"".join(item.data for item in seen if isinstance(item, Chunk)) == packet


def test_finish_delivers_queued_packets(stream: Stream[Count], transport: ScriptedTransport) -> None:
    wake, asleep = threading.Event(), threading.Event()
    got: list[int] = []

    def keep(count: Count) -> None:
        asleep.set()
        assert wake.wait(10)
        got.append(count.number)

    subscription = stream.subscribe(keep, policy=block)
    transport.put(counts(1, 2, 3))
    assert asleep.wait(10)
    until(lambda: stream.stats.received == 3)
    assert not subscription.finish(timeout=0.01)
    wake.set()
    assert subscription.join(10)
    assert got == [1, 2, 3]


def test_invalid_arguments_raise_before_connecting(stream: Stream[Count], transport: ScriptedTransport) -> None:
    with pytest.raises(BadValue, match="deadline"):
        stream.subscribe(print, deadline=0)
    with pytest.raises(BadValue, match="without a deadline"):
        stream.subscribe(print, on_deadline=print)
    with pytest.raises(BadValue):
        drop_oldest(0)
    assert transport.opened == 0


def test_use_after_close_raises_closed(stream: Stream[Count]) -> None:
    stream.close()
    with pytest.raises(Closed):
        stream.subscribe(print)
    with pytest.raises(Closed):
        stream.wait(1)


@pytest.mark.slow
def test_counters_add_up_under_load(stream: Stream[Count], transport: ScriptedTransport) -> None:
    """Many chunks with some bad packets, while subscribers of every policy come and go."""
    total = 0
    delivered = []

    def collect(count: Count) -> None:
        delivered.append(count.number)

    lossless = stream.subscribe(collect, policy=block)
    others = [stream.subscribe(lambda count: None, policy=drop_oldest(2)) for _ in range(3)]
    for round_ in range(300):
        numbers = [BAD if number % 50 == 7 else number for number in range(round_, round_ + 40)]
        total += len(numbers)
        transport.put(counts(*numbers))
        if round_ % 20 == 0:
            others.pop(0).close()
            others.append(stream.subscribe(lambda count: None, policy=latest))
    transport.put(Finished())
    assert stream.join(30)
    adds_up(stream)
    stats = stream.stats
    assert stats.received == total
    assert stats.failed == total - len(delivered)
    assert lossless.stats.dropped == 0
    for subscription in others:
        own = subscription.stats
        assert own.waiting == 0
        assert own.offered == own.delivered + own.dropped

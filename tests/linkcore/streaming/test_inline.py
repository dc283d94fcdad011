"""Inline callbacks: the reader thread calls them after all queues, and counts calls that take too long."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

import pytest

from linkcore.errors import BadValue, ConnectionLost, LocalError
from linkcore.net.transport import Finished
from linkcore.streaming.connection import Connection
from linkcore.streaming.connection_life import Chunk, ConnectionEvent, ConnectionState, Traffic
from linkcore.streaming.packet_queue import block, latest
from linkcore.streaming.stream import Stream
from linkcore.streaming.subscription import Subscription
from tests.fakes.link import Count, ScriptedTransport, counts
from tests.waiting import threads_named, until

pytestmark = pytest.mark.simulated_time


def test_inline_callback_runs_in_the_reader_in_order(stream: Stream[Count], transport: ScriptedTransport) -> None:
    got: list[int] = []
    threads: set[str] = set()

    def take(count: Count) -> None:
        got.append(count.number)
        threads.add(threading.current_thread().name)

    subscription = stream.subscribe(take, inline=True)
    transport.put(counts(1, 2), counts(3), Finished())
    assert stream.join(10)
    assert got == [1, 2, 3]
    assert threads == {"script reader"}
    stats = subscription.stats
    assert (stats.offered, stats.delivered, stats.dropped, stats.raised, stats.waiting) == (3, 3, 0, 0, 0)


def test_inline_callbacks_all_get_a_packet_before_the_next(stream: Stream[Count], transport: ScriptedTransport) -> None:
    """Callbacks run in the order of their subscription, even if several packets arrive at once."""
    got: list[tuple[str, int]] = []
    stream.subscribe(lambda count: got.append(("first", count.number)), inline=True)
    stream.subscribe(lambda count: got.append(("second", count.number)), inline=True)
    transport.put(counts(1, 2), Finished())
    assert stream.join(10)
    assert got == [("first", 1), ("second", 1), ("first", 2), ("second", 2)]


def test_callback_runs_in_its_own_thread_by_default(stream: Stream[Count], transport: ScriptedTransport) -> None:
    """The callback runs in its own thread, however fast it is and however often it has been called."""
    threads: set[threading.Thread] = set()
    stream.subscribe(lambda count: threads.add(threading.current_thread()), policy=block)
    for number in range(500):
        transport.put(counts(number))
    transport.put(Finished())
    assert stream.join(10)
    assert [thread.name for thread in threads] == ["script Count"]


def test_queues_get_a_packet_before_inline_callbacks(stream: Stream[Count], transport: ScriptedTransport) -> None:
    """A hanging inline callback does not delay packets for queues, even for those that subscribed later."""
    go, called = threading.Event(), threading.Event()
    got: list[int] = []

    def hang(count: Count) -> None:
        called.set()
        assert go.wait(10)

    stream.subscribe(hang, inline=True)
    stream.subscribe(lambda count: got.append(count.number))
    transport.put(counts(1))
    assert called.wait(10)
    until(lambda: got == [1])
    assert not go.is_set()
    go.set()


def test_slow_inline_callback_is_counted_and_increases_age(stream: Stream[Count], transport: ScriptedTransport) -> None:
    go, called = threading.Event(), threading.Event()

    def hang(count: Count) -> None:
        if count.number == 0:
            called.set()
            assert go.wait(10)

    subscription = stream.subscribe(hang, inline=True)
    transport.put(counts(0))
    assert called.wait(10)
    assert subscription.stats.waiting == 1
    assert subscription.stats.delivered == 0
    before = stream.stats.age
    time.sleep(0.02)
    after = stream.stats.age
    assert before is not None
    assert after is not None
    assert after - before >= 0.02
    go.set()
    until(lambda: subscription.stats.delivered == 1)
    assert stream.stats.slow_inline == 1


def test_quick_inline_calls_are_not_counted_as_slow(stream: Stream[Count], transport: ScriptedTransport) -> None:
    """A busy computer may delay a few of the calls, so the test accepts up to 99 slow ones."""
    subscription = stream.subscribe(lambda count: None, inline=True)
    for _ in range(20):
        transport.put(counts(*range(50)))
    transport.put(Finished())
    assert stream.join(10)
    assert subscription.stats.delivered == 1000
    assert stream.stats.slow_inline < 100


def test_inline_subscription_rejects_a_policy(stream: Stream[Count], transport: ScriptedTransport) -> None:
    with pytest.raises(BadValue, match="without a queue"):
        stream.subscribe(print, policy=latest, inline=True)
    assert transport.opened == 0


@pytest.mark.parametrize("error", [ValueError("on purpose"), SystemExit(1), KeyboardInterrupt()])
def test_error_in_inline_callback_does_not_stop_reading(
    stream: Stream[Count], transport: ScriptedTransport, caplog: pytest.LogCaptureFixture, error: BaseException
) -> None:
    got: list[int] = []

    def fail(count: Count) -> None:
        raise error

    failing = stream.subscribe(fail, inline=True)
    after = stream.subscribe(lambda count: got.append(count.number), inline=True)
    transport.put(counts(1), counts(2), Finished())
    assert stream.join(10)
    assert got == [1, 2]
    assert (failing.stats.offered, failing.stats.raised, failing.stats.delivered) == (2, 2, 0)
    assert after.stats.delivered == 2
    assert "raised; its subscription continues" in caplog.text


def test_close_waits_for_the_running_inline_call(stream: Stream[Count], transport: ScriptedTransport) -> None:
    go, called = threading.Event(), threading.Event()
    got: list[int] = []

    def keep(count: Count) -> None:
        called.set()
        assert go.wait(10)
        got.append(count.number)

    subscription = stream.subscribe(keep, inline=True)
    transport.put(counts(1, 2, 3))
    assert called.wait(10)
    subscription.close(timeout=0.01)  # times out, because the callback is running
    assert got == []
    closing = threading.Thread(target=subscription.close, args=(10,))
    closing.start()
    go.set()
    closing.join(10)
    assert not closing.is_alive()
    assert got == [1], "the callback must not run after close, even for packets of the same chunk"
    stats = subscription.stats
    assert (stats.offered, stats.delivered, stats.waiting) == (1, 1, 0)


def test_inline_callback_can_close_its_subscription(stream: Stream[Count], transport: ScriptedTransport) -> None:
    got: list[int] = []
    ready = threading.Event()

    def once(count: Count) -> None:
        assert ready.wait(10)
        got.append(count.number)
        subscription.close()

    subscription = stream.subscribe(once, inline=True)
    ready.set()
    transport.put(counts(1, 2), counts(3), Finished())
    assert stream.join(10)
    assert got == [1]


def test_inline_callback_can_close_the_stream(
    stream: Stream[Count], connection: Connection, transport: ScriptedTransport
) -> None:
    closed = threading.Event()

    def close(count: Count) -> None:
        stream.close()
        closed.set()

    stream.subscribe(close, inline=True)
    transport.put(counts(1, 2))
    assert closed.wait(10)
    until(lambda: not connection.is_running)
    assert stream.connection is ConnectionState.CLOSED


def test_close_times_out_when_an_inline_callback_hangs(
    stream: Stream[Count], connection: Connection, transport: ScriptedTransport
) -> None:
    go, called = threading.Event(), threading.Event()

    def hang(count: Count) -> None:
        called.set()
        go.wait(30)

    stream.subscribe(hang, inline=True)
    transport.put(counts(1))
    assert called.wait(10)
    began = time.monotonic()
    stream.close(timeout=0.2)
    assert time.monotonic() - began < 5
    go.set()
    until(lambda: not connection.is_running)


def test_inline_callback_cannot_wait_for_its_stream(stream: Stream[Count], transport: ScriptedTransport) -> None:
    errors: list[LocalError] = []

    def try_to_wait(count: Count) -> None:
        waits: list[Callable[[], object]] = [stream.wait, lambda: next(iter(stream)), stream.of(Count).wait]
        for wait in waits:
            try:
                wait()
            except LocalError as error:
                errors.append(error)

    began = time.monotonic()
    stream.subscribe(try_to_wait, inline=True)
    transport.put(counts(1), Finished())
    assert stream.join(10)
    assert time.monotonic() - began < 5
    assert len(errors) == 3
    assert all("inline=True" in str(error) for error in errors)


def test_inline_callback_can_subscribe_another_callback(stream: Stream[Count], transport: ScriptedTransport) -> None:
    got: list[int] = []
    made: list[Subscription] = []

    def subscribe(count: Count) -> None:
        if not made:
            made.append(stream.subscribe(lambda count: got.append(count.number), policy=block))

    stream.subscribe(subscribe, inline=True)
    transport.put(counts(1), counts(2), Finished())
    assert stream.join(10)
    assert made[0].join(10)
    assert got == [2]


def test_inline_callbacks_get_events_and_bytes(stream: Stream[Count], transport: ScriptedTransport) -> None:
    states: list[ConnectionState] = []
    data: list[bytes] = []
    stream.subscribe(lambda event: states.append(event.state), ConnectionEvent, inline=True)
    stream.subscribe(lambda item: data.append(item.data) if isinstance(item, Chunk) else None, Traffic, inline=True)
    transport.put(counts(1), ConnectionLost("cut"), counts(2), Finished())
    assert stream.join(10)
    assert states[-4:] == [
        ConnectionState.LOST,
        ConnectionState.CONNECTING,
        ConnectionState.CONNECTED,
        ConnectionState.CLOSED,
    ]
    assert data == [counts(1), counts(2)]


def test_inline_subscription_can_be_joined_and_finished(stream: Stream[Count], transport: ScriptedTransport) -> None:
    subscription = stream.subscribe(lambda count: None, inline=True)
    assert not subscription.join(0.01)
    transport.put(counts(1), Finished())
    assert subscription.join(10)
    assert subscription.finish()


def test_inline_subscription_can_have_a_deadline(stream: Stream[Count], transport: ScriptedTransport) -> None:
    ages: list[float] = []
    subscription = stream.subscribe(lambda count: None, deadline=0.02, on_deadline=ages.append, inline=True)
    until(lambda: len(ages) == 1)
    # The deadline is reported once for each silence; only a packet arms it again.
    transport.put(counts(1))
    until(lambda: len(ages) == 2)
    assert subscription.stats.missed_deadlines == 2
    assert all(age >= 0.02 for age in ages)
    subscription.close()
    until(lambda: not any(thread.name == "script Count deadline" for thread in threading.enumerate()))


def test_deadline_of_inline_callback_starts_when_connected(
    stream: Stream[Count], transport: ScriptedTransport, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Connecting may take longer than the deadline."""
    watching: list[list[str]] = []
    connect = transport.open

    def watched(timeout: float) -> None:
        watching.append(threads_named("deadline"))
        connect(timeout)

    monkeypatch.setattr(transport, "open", watched)
    ages: list[float] = []
    stream.subscribe(lambda count: None, deadline=0.02, on_deadline=ages.append, inline=True)
    assert watching == [[]]
    until(lambda: ages)

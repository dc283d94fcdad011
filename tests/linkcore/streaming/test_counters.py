"""Exact values of every counter, and their sums for any order of events.

The tests count the expected numbers on their own, independently of the code.
"""

from __future__ import annotations

import threading
import time
import weakref

import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, precondition, rule, run_state_machine_as_test

import linkcore.clock
from linkcore import clock
from linkcore.errors import ConnectionLost
from linkcore.net.transport import Finished
from linkcore.streaming.connection import Connection
from linkcore.streaming.fanout import FanOut
from linkcore.streaming.packet_queue import PacketQueue, Policy, block, drop_oldest, latest
from linkcore.streaming.statistics import Loop, StreamCounters, SubscriptionStatistics
from linkcore.streaming.stream import Stream
from linkcore.streaming.subscription import Subscription
from tests.fakes.link import AT_ONCE, BAD, Count, CountProtocol, ScriptedTransport, counts, scripted
from tests.waiting import until

pytestmark = pytest.mark.simulated_time


def test_age_is_not_negative_when_a_packet_arrives_meanwhile(monkeypatch: pytest.MonkeyPatch) -> None:
    counters, clock = StreamCounters(), linkcore.clock.now
    counters.arrived = clock()

    def late() -> float:
        now = clock()
        while (arrived := clock()) == now:
            pass
        counters.arrived = arrived  # as if the reader had received a packet before this thread continues
        return now

    monkeypatch.setattr(linkcore.clock, "now", late)
    age = counters.statistics.age
    assert age is not None
    assert age >= 0


def test_stream_counters_equal_expected_values(stream: Stream[Count], transport: ScriptedTransport) -> None:
    stream.subscribe(lambda count: None, policy=block)
    transport.put(b"xx" + counts(1, 2), counts(BAD), counts(3, BAD, BAD), counts(4)[:3])
    transport.put(ConnectionLost("cut"), counts(5), Finished())
    assert stream.join(10)
    stats = stream.stats
    assert stats.received == 7
    assert stats.decoded == 4
    assert stats.failed == 3
    assert stats.bytes == 2 + 7 * 5 + 3
    assert stats.skipped == 2 + 3
    assert stats.resyncs == 1
    assert stats.reconnects == 1
    assert (stats.unknown, stats.tails, stats.slow_inline) == (0, 0, 0)


def test_stats_count_packets_dropped_by_a_slow_loop(stream: Stream[Count], transport: ScriptedTransport) -> None:
    loop = stream.iterate(latest)
    transport.put(counts(1))
    assert next(loop).number == 1
    transport.put(counts(2, 3, 4), counts(5))
    until(lambda: stream.stats.dropped == 3)
    assert next(loop).number == 5
    transport.put(counts(6, 7))
    until(lambda: stream.stats.dropped == 4)
    # A packet that is still queued when the loop ends does not count as dropped.
    loop.close()  # type: ignore[attr-defined]
    transport.put(counts(8, 9), counts(10))
    until(lambda: stream.stats.received == 10)
    assert stream.stats.dropped == 4


def test_ended_loop_is_forgotten() -> None:
    counters, queue = StreamCounters(), PacketQueue(drop_oldest(8))
    seen = weakref.ref(queue)
    counters.loop_began(queue)
    counters.loop_ended(queue)
    del queue
    assert seen() is None


def test_closed_loop_is_reported_to_the_counters(
    stream: Stream[Count], connection: Connection, transport: ScriptedTransport, monkeypatch: pytest.MonkeyPatch
) -> None:
    ended: list[Loop] = []
    monkeypatch.setattr(connection.counters, "loop_ended", ended.append)
    loop = stream.iterate(latest)
    transport.put(counts(1))
    next(loop)
    loop.close()  # type: ignore[attr-defined]
    assert len(ended) == 1


def test_stats_count_packets_expired_in_a_loop(stream: Stream[Count], transport: ScriptedTransport) -> None:
    loop = stream.iterate(drop_oldest(10), lifespan=0.5)
    transport.put(counts(1))
    assert next(loop).number == 1
    transport.put(counts(2, 3))
    until(lambda: stream.stats.received == 3)
    time.sleep(1.0)
    transport.put(counts(4))
    assert next(loop).number == 4
    assert stream.stats.dropped == 2


def test_stats_do_not_count_packets_skipped_by_a_wait(stream: Stream[Count], transport: ScriptedTransport) -> None:
    transport.put(counts(1, 2, 3))
    assert stream.wait(10).number == 3
    assert stream.stats.dropped == 0


def test_stream_stats_include_protocol_counters(transport: ScriptedTransport) -> None:
    """They are included during the connection and after it."""
    protocols = [CountProtocol(), CountProtocol()]
    for name in ("unknown", "tails"):
        setattr(protocols[0], name, 3)
    made = iter(protocols)
    connection = Connection("script", transport, lambda: next(made), FanOut(Count), backoff=AT_ONCE, silence=None)
    stream = Stream(connection, Count)
    stream.start()
    assert (stream.stats.unknown, stream.stats.tails) == (3, 3)
    transport.put(ConnectionLost("cut"))
    until(lambda: stream.stats.reconnects == 1)
    assert (stream.stats.unknown, stream.stats.tails) == (3, 3)
    stream.close()


def test_slow_subscriber_changes_only_its_own_counters(stream: Stream[Count], transport: ScriptedTransport) -> None:
    go, asleep = threading.Event(), threading.Event()

    def hang(count: Count) -> None:
        asleep.set()
        assert go.wait(10)

    slow = stream.subscribe(hang, policy=latest)
    quick = stream.subscribe(lambda count: None, policy=block)
    transport.put(counts(0))
    assert asleep.wait(10)
    transport.put(counts(*range(1, 100)))
    until(lambda: quick.stats.delivered == 100)
    assert (slow.stats.offered, slow.stats.dropped, slow.stats.waiting) == (100, 98, 2)
    assert (quick.stats.offered, quick.stats.dropped, quick.stats.waiting) == (100, 0, 0)
    assert (stream.stats.received, stream.stats.decoded) == (100, 100)
    go.set()


def test_late_subscription_starts_with_zero_counters(stream: Stream[Count], transport: ScriptedTransport) -> None:
    assert stream.latest is None
    transport.put(counts(1, 2, 3))
    until(lambda: stream.stats.decoded == 3)
    late = stream.subscribe(lambda count: None)
    assert late.stats == SubscriptionStatistics(0, 0, 0, 0, 0, 0)


def test_age_is_the_age_of_the_last_packet(stream: Stream[Count], transport: ScriptedTransport) -> None:
    stream.start()
    assert [stream.stats.age] == [None]
    transport.put(b"xx")
    until(lambda: stream.stats.bytes == 2)
    assert [stream.stats.age] == [None], "bytes without a packet do not set the age"
    transport.put(counts(1))
    until(lambda: stream.stats.received == 1)
    time.sleep(0.02)
    age = stream.stats.age
    assert age is not None
    assert age >= 0.02


def test_rate_is_measured_over_the_last_second() -> None:
    began, counters = clock.now(), StreamCounters()
    assert counters.statistics.rate == 0
    counters.received = 500
    assert counters.window_ends == pytest.approx(began + 1.0, abs=1e-3)
    counters.received = 600
    counters.next_window(began + 1.2)
    assert counters.statistics.rate == pytest.approx(500, rel=1e-3)
    counters.received = 700
    counters.next_window(began + 2.3)
    assert counters.statistics.rate == pytest.approx(100 / 1.1, rel=1e-3)


def test_rate_of_a_stopped_stream_decreases() -> None:
    counters = StreamCounters()
    counters.received = 500
    time.sleep(1.0)
    counters.next_window(clock.now())
    counters.received = 1000
    assert counters.statistics.rate == pytest.approx(500, rel=0.1)
    time.sleep(10.0)
    assert counters.statistics.rate == pytest.approx(50, rel=0.1)


class Recipient:
    """Callback that counts its calls, blocks until `go` is set, and raises at each multiple of `raises_at`."""

    def __init__(self, raises_at: int) -> None:
        self.raises_at = raises_at
        self.go = threading.Event()
        self.go.set()
        self.called = self.raised = 0

    def __call__(self, count: Count) -> None:
        assert self.go.wait(30)
        self.called += 1
        if count.number % self.raises_at == 0:
            self.raised += 1
            raise RuntimeError("on purpose")


class StreamMachine(RuleBasedStateMachine):
    """Stream with packets, subscribers, connections and callbacks in any order; the sums hold whenever it is idle."""

    @initialize()
    def begin(self) -> None:
        self.transport = ScriptedTransport()
        self.stream = scripted(self.transport)
        self.stream.start()
        self.made: list[tuple[Subscription, Recipient, bool]] = []
        self.open: list[int] = []
        self.offered: list[int] = []
        self.sent = self.bad = self.bytes = 0
        self.connections = 1

    def teardown(self) -> None:
        if hasattr(self, "stream"):
            for _, recipient, _ in self.made:
                recipient.go.set()
            self.rest()
            self.stream.close()
            for subscription, recipient, _ in self.made:
                until(lambda subscription=subscription: subscription.stats.waiting == 0)  # type: ignore[misc]
                self.check(subscription, recipient)

    def rest(self) -> None:
        """Wait until the reader is idle, and no callback runs except those that are blocked."""
        until(lambda: self.stream.stats.received == self.sent and self.stream.stats.bytes == self.bytes)
        until(lambda: self.stream.stats.decoded + self.stream.stats.failed == self.sent)
        for number in self.open:
            subscription, recipient, _ = self.made[number]
            until(lambda subscription=subscription, number=number: subscription.stats.offered == self.offered[number])  # type: ignore[misc]
            if recipient.go.is_set():
                until(lambda subscription=subscription: subscription.stats.waiting == 0)  # type: ignore[misc]
            else:
                # One packet is in the callback, or none has arrived. The others are in the queue.
                until(lambda subscription=subscription: self.adds_up(subscription.stats))  # type: ignore[misc]

    @staticmethod
    def adds_up(stats: SubscriptionStatistics) -> bool:
        return stats.offered == stats.delivered + stats.dropped + stats.raised + stats.waiting

    def check(self, subscription: Subscription, recipient: Recipient) -> None:
        stats = subscription.stats
        assert self.adds_up(stats), stats
        assert stats.raised == recipient.raised
        assert stats.delivered == recipient.called - recipient.raised

    @rule(numbers=st.lists(st.integers(0, 20).map(lambda n: BAD if n == 0 else n), max_size=12))
    def send(self, numbers: list[int]) -> None:
        data = counts(*numbers)
        if data:
            self.transport.put(data)
        self.sent += len(numbers)
        self.bytes += len(data)
        self.bad += numbers.count(BAD)
        for number in self.open:
            self.offered[number] += len(numbers) - numbers.count(BAD)
        self.rest()

    @precondition(lambda self: len(self.made) < 6)
    @rule(
        policy=st.sampled_from([None, latest, drop_oldest(3), block, Policy(64, drop=None)]),
        raises_at=st.integers(2, 5),
    )
    def subscribe(self, policy: Policy | None, raises_at: int) -> None:
        recipient = Recipient(raises_at)
        is_inline = policy is None
        subscription = self.stream.subscribe(recipient, policy=policy, inline=is_inline)
        self.open.append(len(self.made))
        self.made.append((subscription, recipient, is_inline))
        self.offered.append(0)

    @rule(data=st.data())
    def hold(self, data: st.DataObject) -> None:
        """Block a callback that has its own thread."""
        held = [number for number in self.open if not self.made[number][2]]
        if held:
            self.made[data.draw(st.sampled_from(held))][1].go.clear()

    @rule(data=st.data())
    def release(self, data: st.DataObject) -> None:
        if self.open:
            self.made[data.draw(st.sampled_from(self.open))][1].go.set()
            self.rest()

    @rule(data=st.data(), finish=st.booleans())
    def end(self, data: st.DataObject, finish: bool) -> None:
        if self.open:
            number = data.draw(st.sampled_from(self.open))
            subscription, recipient, _ = self.made[number]
            if finish and recipient.go.is_set():
                assert subscription.finish()
            else:
                subscription.close(timeout=0)
            self.open.remove(number)

    @rule()
    def lose(self) -> None:
        self.transport.put(ConnectionLost("cut"))
        self.connections += 1
        until(lambda: self.stream.stats.reconnects == self.connections - 1)

    @rule()
    def look(self) -> None:
        stats = self.stream.stats
        assert (stats.received, stats.failed, stats.decoded) == (self.sent, self.bad, self.sent - self.bad)
        for number in self.open:
            subscription, recipient, is_inline = self.made[number]
            stats_of = subscription.stats
            assert stats_of.offered == self.offered[number]
            if recipient.go.is_set():
                assert stats_of.waiting == 0
                self.check(subscription, recipient)
            if is_inline:
                assert stats_of.dropped == 0


@pytest.mark.property
def test_counters_add_up_for_any_order_of_events() -> None:
    run_state_machine_as_test(StreamMachine, settings=settings(stateful_step_count=20))

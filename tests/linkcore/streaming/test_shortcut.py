"""Callbacks that the reader makes itself: only while they are quick, and at nobody's cost."""

from __future__ import annotations

import threading
from collections.abc import Iterator

import pytest

from linkcore.errors import ConnectionLost
from linkcore.net.transport import Finished
from linkcore.streaming.backoff import Backoff
from linkcore.streaming.packet_queue import Inbox
from linkcore.streaming.policy import block, latest
from linkcore.streaming.stream import Stream
from linkcore.streaming.subscription import Subscription
from tests.linkcore.script import Count, CountProtocol, ScriptedTransport, counts
from tests.waiting import until


class Callback:
    """Notes what it got and in which thread; can be told to be slow or to fail."""

    def __init__(self) -> None:
        self.numbers: list[int] = []
        self.thread = ""
        self.gate: threading.Event | None = None
        self.stuck = threading.Event()
        self.running = 0
        self.fails = False

    def __call__(self, count: Count) -> None:
        self.running += 1
        assert self.running == 1, "two calls at a time"
        self.thread = threading.current_thread().name
        if self.gate is not None:
            self.stuck.set()
            assert self.gate.wait(10)
        self.numbers.append(count.number)
        self.running -= 1
        if self.fails:
            raise RuntimeError("on purpose")


@pytest.fixture
def transport() -> ScriptedTransport:
    return ScriptedTransport()


@pytest.fixture
def stream(transport: ScriptedTransport) -> Iterator[Stream[Count]]:
    stream = Stream("script", transport, CountProtocol, Count, backoff=Backoff(first=0, most=0), silence=None)
    yield stream
    stream.close()
    stats = stream.stats
    assert stats.received == stats.delivered + stats.dropped + stats.failed
    until(lambda: not [thread for thread in threading.enumerate() if thread.name.startswith("script")])


class Feeding:
    """Sends numbers, one packet at a time, each when the one before has been taken."""

    def __init__(self, transport: ScriptedTransport) -> None:
        self.transport = transport
        self.sent = 0

    def send(self, many: int = 1) -> None:
        for _ in range(many):
            self.transport.put(counts(self.sent))
            self.sent += 1

    def until_trusted(self, callback: Callback, subscription: Subscription) -> None:
        def trusted() -> bool:
            self.send()
            until(lambda: subscription.stats.delivered == self.sent)
            return callback.thread.endswith("reader")

        until(trusted)


@pytest.fixture
def feeding(transport: ScriptedTransport) -> Feeding:
    return Feeding(transport)


def test_a_quick_callback_comes_to_be_called_by_the_reader(stream: Stream[Count], feeding: Feeding) -> None:
    callback = Callback()
    subscription = stream.subscribe(callback, policy=block)
    feeding.send()
    until(lambda: callback.numbers)
    assert callback.thread == "script Count"
    feeding.until_trusted(callback, subscription)
    assert feeding.sent > 64
    feeding.transport.put(counts(*range(feeding.sent, feeding.sent + 50)), Finished())
    assert stream.join(10)
    assert callback.numbers == list(range(feeding.sent + 50))
    assert subscription.stats.delivered == subscription.stats.received == feeding.sent + 50


def test_a_callback_that_hangs_loses_the_reader_and_nothing_else(stream: Stream[Count], feeding: Feeding) -> None:
    callback, other = Callback(), Callback()
    subscription = stream.subscribe(callback, policy=block)
    feeding.until_trusted(callback, subscription)
    beside = stream.subscribe(other, policy=block)
    callback.gate = threading.Event()
    first = feeding.sent
    feeding.send(3)
    assert callback.stuck.wait(10)
    feeding.send(40)
    # While the one still hangs, the other gets everything.
    until(lambda: other.numbers[-1:] == [feeding.sent - 1])
    assert other.numbers == list(range(first, feeding.sent))
    assert callback.numbers == list(range(first))
    assert subscription.stats.waiting == feeding.sent - first
    callback.gate.set()
    until(lambda: len(callback.numbers) == feeding.sent)
    assert callback.numbers == list(range(feeding.sent))
    assert callback.thread == "script Count"
    assert stream.stats.dropped == 0
    assert beside.stats.delivered == feeding.sent - first


def test_a_callback_that_was_slow_goes_back_to_its_own_thread(stream: Stream[Count], feeding: Feeding) -> None:
    callback = Callback()
    subscription = stream.subscribe(callback, policy=block)
    feeding.until_trusted(callback, subscription)
    for _ in range(4):  # three within a second may be the machine's fault
        callback.stuck.clear()
        callback.gate = threading.Event()
        feeding.send()
        assert callback.stuck.wait(10)
        assert callback.thread.endswith("reader")
        timer = threading.Timer(0.002, callback.gate.set)  # longer than quick, shorter than patience
        timer.start()
        until(lambda: subscription.stats.delivered == feeding.sent)
        timer.join()
    callback.gate = None
    feeding.send()
    until(lambda: subscription.stats.delivered == feeding.sent)
    assert callback.thread == "script Count"
    assert callback.numbers == list(range(feeding.sent))


def test_the_reader_trusts_one_at_a_time(stream: Stream[Count], feeding: Feeding) -> None:
    one, two = Callback(), Callback()
    first = stream.subscribe(one, policy=block)
    feeding.until_trusted(one, first)
    second = stream.subscribe(two, policy=block)
    for _ in range(100):
        feeding.send()
        until(lambda: first.stats.delivered == feeding.sent and second.stats.waiting == 0)
    assert two.thread == "script Count"
    first.close()
    feeding.until_trusted(two, SinceThen(second, feeding.sent))  # type: ignore[arg-type]
    assert one.numbers == list(range(len(one.numbers)))


class SinceThen:
    """A subscription that came later, counted as if it had been there from the start."""

    def __init__(self, subscription: Subscription, sent: int) -> None:
        self._subscription = subscription
        self._missing = sent - subscription.stats.delivered

    @property
    def stats(self) -> SinceThen:
        return self

    @property
    def delivered(self) -> int:
        return self._subscription.stats.delivered + self._missing


def test_failures_are_counted_there_too(
    stream: Stream[Count], feeding: Feeding, caplog: pytest.LogCaptureFixture
) -> None:
    callback = Callback()
    subscription = stream.subscribe(callback, policy=block)
    feeding.until_trusted(callback, subscription)
    callback.fails = True
    delivered = subscription.stats.delivered
    feeding.transport.put(counts(*range(feeding.sent, feeding.sent + 10)), Finished())
    assert stream.join(10)
    stats = subscription.stats
    assert (stats.delivered, stats.failed, stats.waiting) == (delivered, 10, 0)
    assert callback.numbers == list(range(feeding.sent + 10))


def test_deadlines_hold_there_too(stream: Stream[Count], feeding: Feeding) -> None:
    callback = Callback()
    ages: list[float] = []
    subscription = stream.subscribe(callback, policy=block, deadline=0.05, on_deadline=ages.append)
    feeding.until_trusted(callback, subscription)
    ages.clear()
    until(lambda: ages)
    assert ages[0] >= 0.05
    feeding.send()
    until(lambda: subscription.stats.delivered == feeding.sent)
    assert callback.thread.endswith("reader")
    until(lambda: len(ages) == 2)


def test_closing_the_stream_from_there(stream: Stream[Count], feeding: Feeding) -> None:
    closed = threading.Event()
    callback = Callback()

    def close_at_last(count: Count) -> None:
        callback(count)
        if count.number == 10_000:
            stream.close()
            closed.set()

    subscription = stream.subscribe(close_at_last, policy=block)
    feeding.until_trusted(callback, subscription)
    feeding.transport.put(counts(10_000, 1, 2))
    assert closed.wait(10)
    assert callback.numbers[feeding.sent] == 10_000


def test_closing_the_subscription_waits_for_the_call(stream: Stream[Count], feeding: Feeding) -> None:
    callback = Callback()
    subscription = stream.subscribe(callback, policy=block)
    feeding.until_trusted(callback, subscription)
    callback.gate = threading.Event()
    feeding.send()
    assert callback.stuck.wait(10)
    subscription.close(timeout=0.01)
    assert len(callback.numbers) == feeding.sent - 1
    callback.gate.set()
    assert subscription.join(10)
    assert len(callback.numbers) == feeding.sent


def test_under_latest_it_takes_what_comes(stream: Stream[Count], feeding: Feeding) -> None:
    callback = Callback()
    subscription = stream.subscribe(callback, policy=latest)
    feeding.until_trusted(callback, subscription)
    feeding.transport.put(counts(*range(feeding.sent, feeding.sent + 20)), Finished())
    assert stream.join(10)
    assert callback.numbers == list(range(feeding.sent + 20))
    assert subscription.stats.dropped == 0


def test_what_its_own_thread_has_taken_comes_first() -> None:
    """Else the reader would overtake a packet that has left the queue and not reached the callback."""
    inbox = Inbox(block)
    in_callback, go_on = threading.Event(), threading.Event()
    numbers: list[int] = []

    def keep(count: Count) -> None:
        in_callback.set()
        assert go_on.wait(10)
        numbers.append(count.number)

    subscription = Subscription(inbox, keep, name="script own", detach=lambda subscription: None)
    inbox.offer([Count(number=1)])
    assert in_callback.wait(10)
    assert not subscription.deliver([Count(number=2)])
    inbox.received += 1  # as if a second one had been taken from the queue
    go_on.set()
    until(lambda: numbers)
    assert not subscription.deliver([Count(number=2)])
    inbox.received -= 1
    until(lambda: subscription.deliver([Count(number=2)]))
    assert numbers == [1, 2]
    subscription.close()


def test_a_stream_that_starts_anew_has_forgotten_it(transport: ScriptedTransport) -> None:
    """Who was called by the reader of a stream that gave up is not called again when it is used again."""
    feeding, callback = Feeding(transport), Callback()
    stream = Stream("script", transport, CountProtocol, Count, backoff=Backoff(tries=0), silence=None)
    subscription = stream.subscribe(callback, policy=block)
    feeding.until_trusted(callback, subscription)
    transport.put(ConnectionLost("cut"))
    assert subscription.join(10)
    before = list(callback.numbers)
    assert stream.latest is None  # connects again, with nobody subscribed
    transport.put(counts(1234))
    until(lambda: stream.latest is not None)
    assert callback.numbers == before
    stream.close()

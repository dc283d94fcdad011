"""The queue of one consumer: order, limits, and counters that add up under every policy."""

from __future__ import annotations

import threading
import time

import pytest
from hypothesis import strategies as st
from hypothesis.stateful import (
    RuleBasedStateMachine,
    initialize,
    invariant,
    precondition,
    rule,
    run_state_machine_as_test,
)

from linkcore.errors import BadValue
from linkcore.streaming.packet_queue import PacketQueue, Policy, block, drop_oldest, latest
from tests.waiting import until

pytestmark = pytest.mark.simulated_time

policies = st.one_of(
    st.just(latest),
    st.integers(1, 5).map(drop_oldest),
    st.integers(1, 5).map(lambda limit: Policy(limit, drop=None)),
)


class QueueMachine(RuleBasedStateMachine):
    """Compare a queue with a list, in one thread. The tests below cover `block` with a full queue."""

    @initialize(policy=policies)
    def begin(self, policy: Policy) -> None:
        self.policy = policy
        self.queue = PacketQueue(policy)
        self.counter = 0
        self.model: list[int] = []
        self.offered = self.taken = self.dropped = 0
        self.is_ended = self.is_over = False

    @rule(count=st.integers(0, 12))
    def offer(self, count: int) -> None:
        if self.policy.makes_reader_wait and not self.is_ended:
            count = min(count, self.policy.limit - len(self.model))
        packets = list(range(self.counter, self.counter + count))
        self.counter += count
        self.queue.offer(packets)
        if self.is_ended:
            return
        self.offered += count
        self.model += packets
        surplus = max(len(self.model) - self.policy.limit, 0)
        self.dropped += surplus
        del self.model[:surplus]

    @rule()
    def take(self) -> None:
        packet = self.queue.next(0)
        assert packet == (self.model.pop(0) if self.model else None)
        self.taken += packet is not None
        self.is_over = self.is_over or (packet is None and self.is_ended)

    @rule()
    def end(self) -> None:
        self.queue.end()
        self.is_ended = True

    @precondition(lambda self: self.counter > 3)
    @rule()
    def close(self) -> None:
        self.queue.close()
        self.is_ended = self.is_over = True
        self.dropped += len(self.model)
        self.model = []

    @invariant()
    def counters_add_up(self) -> None:
        queue = self.queue
        assert (queue.offered, queue.dropped, queue.waiting) == (self.offered, self.dropped, len(self.model))
        assert queue.offered == self.taken + queue.dropped + queue.waiting
        assert queue.waiting <= self.policy.limit

    @invariant()
    def is_over_once_its_consumer_has_been_told(self) -> None:
        assert self.queue.is_over == self.is_over


@pytest.mark.property
def test_queue_behaves_like_its_model_for_any_operations() -> None:
    run_state_machine_as_test(QueueMachine)


def test_drop_oldest_keeps_the_newest() -> None:
    queue = PacketQueue(drop_oldest(3))
    queue.offer(range(10))
    assert [queue.next(0) for _ in range(4)] == [7, 8, 9, None]
    assert (queue.offered, queue.dropped, queue.waiting) == (10, 7, 0)


def test_drop_oldest_replaces_the_oldest_when_full() -> None:
    queue = PacketQueue(drop_oldest(4))
    queue.offer([1, 2, 3])
    queue.offer([4, 5])
    assert [queue.next(0) for _ in range(5)] == [2, 3, 4, 5, None]
    assert (queue.offered, queue.dropped) == (5, 1)


@pytest.mark.parametrize("policy", [latest, block])
def test_queued_packets_can_be_taken_after_the_end(policy: Policy) -> None:
    queue = PacketQueue(policy)
    queue.offer([1])
    queue.end()
    queue.offer([2])
    assert not queue.is_over
    # Without a timeout, because `next` must not wait if packets are queued or the queue has ended.
    assert [queue.next(), queue.next(), queue.next(), queue.is_over] == [1, None, None, True]
    assert queue.offered == 1


def test_next_returns_none_after_its_timeout() -> None:
    queue = PacketQueue(latest)
    queue.end()
    fresh = PacketQueue(latest)
    began = time.monotonic()
    assert fresh.next(0.05) is None
    assert 0.05 <= time.monotonic() - began < 5
    assert not fresh.is_over


def consume(queue: PacketQueue) -> tuple[threading.Thread, list[object]]:
    """Start a thread that takes packets until the end; return it with the list of taken packets."""
    taken: list[object] = []

    def run() -> None:
        while (packet := queue.next()) is not None:
            taken.append(packet)

    thread = threading.Thread(target=run)
    thread.start()
    return thread, taken


@pytest.mark.parametrize("policy", [latest, drop_oldest(3), block])
@pytest.mark.parametrize("finish", ["end", "close"])
def test_end_and_close_wake_a_waiting_consumer(policy: Policy, finish: str) -> None:
    queue = PacketQueue(policy)
    thread, taken = consume(queue)
    queue.offer([1])
    until(lambda: taken == [1])
    getattr(queue, finish)()
    thread.join(10)
    assert not thread.is_alive()


def test_steady_packets_are_processed_in_place_of_a_waiting_consumer() -> None:
    queue, seen = PacketQueue(latest), []
    accepts = True

    def take(packet: object) -> bool:
        seen.append(packet)
        return accepts

    queue.take_in_place = take
    queue.offer_steady([1])  # the consumer does not wait yet
    assert [seen, queue.waiting] == [[], 1]
    thread, taken = consume(queue)
    until(lambda: queue._consumer_sleeps)
    queue.offer_steady([2])
    until(lambda: queue._consumer_sleeps)
    accepts = False
    queue.offer_steady([3])
    until(lambda: taken == [1, 3])
    until(lambda: queue._consumer_sleeps)
    queue.offer_steady([4, 5])  # with `latest`, only the newest one stays
    until(lambda: taken == [1, 3, 5])
    assert seen == [2, 3]
    assert (queue.offered, queue.taken, queue.dropped) == (5, 4, 1)
    queue.close()
    thread.join(10)
    queue.offer_steady([6])
    assert [seen, queue.offered, queue.taken_in_place] == [[2, 3], 5, 1]


def test_block_policy_waits_for_room_and_drops_nothing() -> None:
    queue = PacketQueue(Policy(4, drop=None))
    offered = threading.Thread(target=queue.offer, args=(range(100),))
    offered.start()
    until(lambda: queue.waiting == 4)
    assert offered.is_alive()
    assert [queue.next(10) for _ in range(100)] == list(range(100))
    offered.join(10)
    assert not offered.is_alive()
    assert (queue.offered, queue.dropped, queue.waiting) == (100, 0, 0)


def test_close_ends_an_offer_waiting_for_room() -> None:
    queue = PacketQueue(Policy(4, drop=None))
    offered = threading.Thread(target=queue.offer, args=(range(100),))
    offered.start()
    until(lambda: queue.waiting == 4)
    queue.close()
    offered.join(10)
    assert not offered.is_alive()
    assert (queue.offered, queue.dropped, queue.waiting) == (100, 100, 0)


class Meanwhile(list[int]):
    """Packets that end or close their queue while they are being offered, as another thread could."""

    queue: PacketQueue
    finish = "close"

    def __len__(self) -> int:
        getattr(self.queue, self.finish)()
        return super().__len__()


@pytest.mark.parametrize("policy", [latest, drop_oldest(2), drop_oldest(9), block])
def test_close_during_an_offer_drops_its_packets(policy: Policy) -> None:
    queue = PacketQueue(policy)
    packets = Meanwhile([1, 2, 3])
    packets.queue = queue
    queue.offer(packets)
    assert (queue.offered, queue.dropped, queue.waiting) == (3, 3, 0)
    assert queue.is_over


def test_end_during_an_offer_counts_every_packet() -> None:
    """The consumer has seen the end, and then more packets arrive."""
    queue = PacketQueue(drop_oldest(9))
    packets = Meanwhile([1, 2, 3])
    packets.queue, packets.finish = queue, "end"
    thread, taken = consume(queue)
    queue.offer(packets)
    thread.join(10)
    assert queue.offered == 3 == len(taken) + queue.dropped + queue.waiting
    assert queue.waiting == 0 or not queue.is_over


@pytest.mark.slow
@pytest.mark.parametrize("policy", [latest, drop_oldest(8), Policy(8, drop=None)])
def test_counters_add_up_between_threads(policy: Policy) -> None:
    queue = PacketQueue(policy)
    thread, taken = consume(queue)
    for first in range(0, 30_000, 6):
        queue.offer(range(first + 1, first + 1 + first % 7))
    total = sum(first % 7 for first in range(0, 30_000, 6))
    queue.end()
    thread.join(30)
    assert not thread.is_alive()
    assert queue.offered == total == len(taken) + queue.dropped
    assert queue.waiting == 0
    assert not policy.makes_reader_wait or queue.dropped == 0
    assert taken == sorted(set(taken))  # type: ignore[type-var]


@pytest.mark.slow
def test_latest_policy_never_drops_the_newest() -> None:
    """A packet must not be lost if the consumer takes one while the reader makes room for it."""
    queue = PacketQueue(latest)
    thread, taken = consume(queue)
    for number in range(2, 4000, 2):
        queue.offer([number])
        queue.offer([number + 1])
        end = time.monotonic() + 10
        while taken[-1:] != [number + 1]:
            assert time.monotonic() < end, "the newest was dropped"
            time.sleep(0)
    queue.end()
    thread.join(10)
    assert len(taken) + queue.dropped == queue.offered


@pytest.mark.slow
def test_queue_counts_every_packet_when_closed_at_any_moment() -> None:
    for round_ in range(60):
        queue = PacketQueue(drop_oldest(5) if round_ % 2 else Policy(5, drop=None))
        thread, taken = consume(queue)
        offering = threading.Thread(target=offer_often, args=(queue,))
        offering.start()
        while queue.offered < 7 * round_ % 90:
            offering.join(0)
        queue.close()
        for each in (offering, thread):
            each.join(10)
            assert not each.is_alive()
        assert queue.offered == len(taken) + queue.dropped + queue.waiting


def offer_often(queue: PacketQueue) -> None:
    for _ in range(20):
        queue.offer(range(1, 9))


def test_policy_rejects_limits_below_one() -> None:
    for limit in (0, -1):
        with pytest.raises(BadValue, match="expected a limit of 1 or more"):
            drop_oldest(limit)
        with pytest.raises(BadValue, match="expected a limit of 1 or more"):
            Policy(limit, drop=None)

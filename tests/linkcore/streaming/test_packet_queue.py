"""The queue of one consumer: order, limits, and counters that add up under every policy."""

from __future__ import annotations

import threading
from collections.abc import Iterator

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
from linkcore.streaming.packet_queue import Inbox
from linkcore.streaming.policy import Policy, block, drop_oldest, latest
from tests.waiting import until

policies = st.one_of(
    st.just(latest),
    st.integers(1, 5).map(drop_oldest),
    st.integers(1, 5).map(lambda limit: Policy(limit, evicts=False)),
)


class InboxMachine(RuleBasedStateMachine):
    """An inbox beside a list. One thread: what `block` does when full is tested below."""

    @initialize(policy=policies, picky=st.booleans())
    def begin(self, policy: Policy, picky: bool) -> None:
        self.policy = policy
        self.picky = picky
        self.lost: list[int] = []
        self.inbox = Inbox(policy, wants=(lambda item: item % 2 == 0) if picky else None, lost=self.lost.append)
        self.counter = 0
        self.model: list[int] = []
        self.expected_lost: list[int] = []
        self.received = self.taken = 0
        self.ended = False

    @rule(count=st.integers(0, 12))
    def offer(self, count: int) -> None:
        if not self.policy.evicts and not self.ended:
            count = min(count, self.policy.limit - len(self.model))
        items = list(range(self.counter, self.counter + count))
        self.counter += count
        self.inbox.offer(items)
        if self.ended:
            return
        wanted = [item for item in items if item % 2 == 0] if self.picky else items
        self.received += len(wanted)
        self.model += wanted
        while len(self.model) > self.policy.limit:
            self.expected_lost.append(self.model.pop(0))

    @rule()
    def take(self) -> None:
        item = self.inbox.next(0)
        assert item == (self.model.pop(0) if self.model else None)
        self.taken += item is not None

    @rule()
    def end(self) -> None:
        self.inbox.end()
        self.ended = True

    @precondition(lambda self: self.counter > 3)
    @rule()
    def close(self) -> None:
        self.inbox.close()
        self.ended = True
        self.expected_lost += self.model
        self.model = []
        assert self.inbox.closed

    @invariant()
    def counters_add_up(self) -> None:
        inbox = self.inbox
        assert inbox.received == self.received == self.taken + inbox.dropped + inbox.waiting
        assert inbox.waiting == len(self.model) <= self.policy.limit

    @invariant()
    def what_is_lost_is_told_in_order(self) -> None:
        assert self.lost == self.expected_lost
        assert self.inbox.dropped == len(self.lost)

    @invariant()
    def is_over_when_nothing_can_come(self) -> None:
        assert self.inbox.is_over == (self.ended and not self.model)


@pytest.mark.property
def test_behaves_as_a_list_does() -> None:
    run_state_machine_as_test(InboxMachine)


def test_keeps_the_newest() -> None:
    inbox = Inbox(drop_oldest(3))
    inbox.offer(range(10))
    assert [inbox.next(0) for _ in range(4)] == [7, 8, 9, None]
    assert (inbox.received, inbox.dropped, inbox.waiting) == (10, 7, 0)


@pytest.mark.parametrize("policy", [latest, block])
def test_what_waits_at_the_end_can_be_taken(policy: Policy) -> None:
    inbox = Inbox(policy)
    inbox.offer([1])
    inbox.end()
    inbox.offer([2])
    assert not inbox.is_over
    # Without a timeout: neither what waits nor the end may make it wait.
    assert [inbox.next(), inbox.next(), inbox.next(), inbox.is_over] == [1, None, None, True]
    assert inbox.received == 1


def consume(inbox: Inbox) -> tuple[threading.Thread, list[object]]:
    """A thread that takes until the end."""
    taken: list[object] = []

    def run() -> None:
        while (item := inbox.next()) is not None:
            taken.append(item)

    thread = threading.Thread(target=run)
    thread.start()
    return thread, taken


@pytest.mark.parametrize("policy", [latest, drop_oldest(4), block])
@pytest.mark.parametrize("finish", ["end", "close"])
def test_a_consumer_that_waits_is_woken(policy: Policy, finish: str) -> None:
    inbox = Inbox(policy)
    thread, taken = consume(inbox)
    inbox.offer([1])
    until(lambda: taken == [1])
    getattr(inbox, finish)()
    thread.join(10)
    assert not thread.is_alive()


def test_block_waits_for_room_and_keeps_everything() -> None:
    inbox = Inbox(Policy(4, evicts=False))
    offered = threading.Thread(target=inbox.offer, args=(range(100),))
    offered.start()
    until(lambda: inbox.waiting == 4)
    assert offered.is_alive()
    assert [inbox.next(10) for _ in range(100)] == list(range(100))
    offered.join(10)
    assert not offered.is_alive()
    assert (inbox.received, inbox.dropped, inbox.waiting) == (100, 0, 0)


def test_close_frees_a_reader_that_waits_for_room() -> None:
    lost: list[int] = []
    inbox = Inbox(Policy(4, evicts=False), lost=lost.append)
    offered = threading.Thread(target=inbox.offer, args=(range(100),))
    offered.start()
    until(lambda: inbox.waiting == 4)
    inbox.close()
    offered.join(10)
    assert not offered.is_alive()
    assert (inbox.received, inbox.dropped, inbox.waiting) == (100, 100, 0)
    assert sorted(lost) == list(range(100))


class ClosedMeanwhile(list[int]):
    """Items whose inbox is closed, by another thread as it were, while they are being handed over."""

    inbox: Inbox

    def __iter__(self) -> Iterator[int]:
        self.inbox.close()
        return super().__iter__()


@pytest.mark.parametrize("policy", [latest, drop_oldest(2), block])
def test_closed_in_the_middle_of_an_offer_it_keeps_nothing(policy: Policy) -> None:
    inbox = Inbox(policy)
    items = ClosedMeanwhile([1, 2, 3])
    items.inbox = inbox
    inbox.offer(items)
    assert inbox.received == inbox.dropped + inbox.waiting
    assert inbox.waiting == 0
    assert inbox.is_over


@pytest.mark.slow
@pytest.mark.parametrize("policy", [latest, drop_oldest(8), Policy(8, evicts=False)])
def test_counters_add_up_between_threads(policy: Policy) -> None:
    lost: list[int] = []
    inbox = Inbox(policy, lost=lost.append)
    thread, taken = consume(inbox)
    for first in range(0, 30_000, 6):
        inbox.offer(range(first + 1, first + 1 + first % 7))
    total = sum(first % 7 for first in range(0, 30_000, 6))
    inbox.end()
    thread.join(30)
    assert not thread.is_alive()
    assert inbox.received == total == len(taken) + inbox.dropped
    assert inbox.waiting == 0
    assert inbox.dropped == len(lost) == (0 if not policy.evicts else len(lost))
    assert taken == sorted(taken)  # type: ignore[type-var]
    assert len({*taken, *lost}) == total, "each is either taken or lost, and once"


@pytest.mark.slow
def test_closing_at_any_moment_leaves_nothing_uncounted() -> None:
    for round_ in range(200):
        inbox = Inbox(drop_oldest(5) if round_ % 2 else Policy(5, evicts=False))
        thread, taken = consume(inbox)
        offering = threading.Thread(target=offer_often, args=(inbox,))
        offering.start()
        while inbox.received < round_ % 90:
            offering.join(0)
        inbox.close()
        for each in (offering, thread):
            each.join(10)
            assert not each.is_alive()
        assert inbox.received == len(taken) + inbox.dropped + inbox.waiting


def offer_often(inbox: Inbox) -> None:
    for _ in range(20):
        inbox.offer(range(1, 9))


def test_a_limit_of_nothing_is_refused() -> None:
    with pytest.raises(BadValue, match="at least one"):
        drop_oldest(0)

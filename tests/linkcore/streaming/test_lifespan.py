"""Packets older than their lifespan when taken are dropped and counted, in threads, loops and tasks."""

from __future__ import annotations

import asyncio
import threading
from typing import Any, NamedTuple

import pytest
from hypothesis import given
from hypothesis import strategies as st

import linkcore.clock
from linkcore.aio.packets import LoopQueue
from linkcore.clock import Stamp
from linkcore.errors import BadValue
from linkcore.streaming.packet_queue import PacketQueue, Policy, drop_oldest
from tests.fakes.link import Count, ScriptedTransport, counts, scripted
from tests.waiting import until

pytestmark = pytest.mark.simulated_time

#: Lifespan in seconds. Old packets are twice as old, and new packets stay younger however busy the machine is.
LIFESPAN = 500.0


class Packet(NamedTuple):
    number: int
    received: Stamp | None


class _Connection:
    """Connection of an event loop that is never paused."""

    def hold(self, queue: object) -> None:
        pass

    def release(self, queue: object) -> None:
        pass

    def look(self) -> None:
        pass


@pytest.mark.property
@pytest.mark.parametrize("kind", ["thread", "loop"])
@given(
    st.integers(1, 6),
    st.booleans(),
    st.lists(st.one_of(st.lists(st.sampled_from([0.0, 2 * LIFESPAN, None]), max_size=8), st.just("take")), max_size=30),
)
def test_every_packet_is_delivered_dropped_or_queued(
    kind: str, limit: int, drops: bool, steps: list[list[float | None] | str]
) -> None:
    connection: Any = _Connection()
    policy = drop_oldest(limit) if drops else Policy(limit, drop=None)
    queue = PacketQueue(policy, LIFESPAN) if kind == "thread" else LoopQueue(policy, connection, LIFESPAN)
    model: list[tuple[int, bool]] = []
    offered = taken = evicted = expired = 0
    for step in steps:
        if isinstance(step, list):
            # In a single thread, a queue that drops nothing must not be offered more packets than it has room for.
            ages = step if drops else step[: limit - len(model)]
            now = linkcore.clock.now()
            packets = [
                Packet(number, None if age is None else Stamp(now - age, 0.0))
                for number, age in enumerate(ages, offered)
            ]
            queue.offer(packets)
            model += [(number, bool(age)) for number, age in enumerate(ages, offered)]
            offered += len(ages)
            surplus = max(len(model) - limit, 0)
            evicted += surplus
            del model[:surplus]
        else:
            packet = queue.next(0) if isinstance(queue, PacketQueue) else queue.take()
            while model and model[0][1]:
                del model[0]
                expired += 1
            assert (None if packet is None else packet.number) == (model[0][0] if model else None)
            if model:
                del model[0]
                taken += 1
        assert queue.offered == offered == taken + queue.dropped + queue.waiting
        assert (queue.dropped, queue.expired, queue.waiting) == (evicted + expired, expired, len(model))


def test_subscription_drops_expired_packets() -> None:
    transport = ScriptedTransport()
    is_held, goes_on = threading.Event(), threading.Event()
    seen: list[int] = []

    def hold(count: Count) -> None:
        seen.append(count.number)
        is_held.set()
        goes_on.wait(30)

    with_lifespan: dict[str, Any] = {"policy": drop_oldest(8), "lifespan": 1.0}
    stream = scripted(transport)
    subscription = stream.subscribe(hold, **with_lifespan)
    transport.put(counts(1))
    assert is_held.wait(10)
    transport.put(counts(2, 3, 4))
    until(lambda: stream.stats.received == 4)
    old = linkcore.clock.now() + 1.1
    until(lambda: linkcore.clock.now() > old)
    goes_on.set()
    until(lambda: subscription.stats.expired == 3)
    transport.put(counts(5))
    until(lambda: subscription.stats.delivered == 2)
    stats = subscription.stats
    assert seen == [1, 5]
    assert (stats.offered, stats.delivered, stats.dropped, stats.expired, stats.raised, stats.waiting) == (
        5,
        2,
        3,
        3,
        0,
        0,
    )
    stream.close()


def test_iteration_drops_expired_packets() -> None:
    transport = ScriptedTransport()
    stream = scripted(transport)
    states = stream.iterate(drop_oldest(8), timeout=20, lifespan=1.0)
    transport.put(counts(1))
    assert next(states).number == 1
    transport.put(counts(2, 3))
    until(lambda: stream.stats.received == 3)
    old = linkcore.clock.now() + 1.1
    until(lambda: linkcore.clock.now() > old)
    transport.put(counts(4))
    assert next(states).number == 4
    stream.close()


def test_task_keeps_waiting_when_all_packets_expired() -> None:
    """The task keeps waiting if all packets that have arrived are too old."""
    connection: Any = _Connection()

    async def wait() -> None:
        queue = LoopQueue(drop_oldest(8), connection, LIFESPAN)
        old = Stamp(linkcore.clock.now() - 2 * LIFESPAN, 0.0)
        queue.offer([Packet(number, old) for number in range(3)])
        assert await queue.next(0.01) is None
        assert (queue.taken, queue.dropped, queue.expired, queue.is_over) == (0, 3, 3, False)
        waiting = asyncio.ensure_future(queue.next())
        await asyncio.sleep(0)
        queue.offer([Packet(3, old)])
        await asyncio.sleep(0)
        queue.offer([Packet(4, Stamp.now())])
        packet = await waiting
        assert packet is not None
        assert packet.number == 4
        assert queue.expired == 4

    asyncio.run(asyncio.wait_for(wait(), 20))


@pytest.mark.parametrize("lifespan", [0, -1.0, float("nan"), "1"])
def test_invalid_lifespan_is_rejected(lifespan: Any) -> None:
    stream = scripted(ScriptedTransport())
    with pytest.raises(BadValue, match="lifespan"):
        stream.subscribe(print, lifespan=lifespan)
    with pytest.raises(BadValue, match="lifespan"):
        stream.iterate(lifespan=lifespan)


def test_inline_subscription_rejects_a_lifespan() -> None:
    stream = scripted(ScriptedTransport())
    with pytest.raises(BadValue, match="cannot be combined with policy or lifespan"):
        stream.subscribe(print, lifespan=1.0, inline=True)


def test_thread_queue_does_not_return_expired_packets() -> None:
    queue = PacketQueue(drop_oldest(8), LIFESPAN)
    queue.offer([Packet(0, Stamp(linkcore.clock.now() - 2 * LIFESPAN, 0.0))])
    assert queue.next(0.01) is None
    assert not queue.is_over

"""The queue for threads and the queue for tasks behave the same with the same packets, for every policy."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

import linkcore.clock
from linkcore.aio.packets import LoopQueue
from linkcore.clock import Stamp
from linkcore.streaming.fanout import FanOut
from linkcore.streaming.packet_queue import BoundedQueue, PacketQueue, Policy, drop_oldest, latest

pytestmark = pytest.mark.simulated_time

LIFESPAN = 1.0


@dataclass
class Packet:
    number: int
    received: Stamp


class Unread:
    """Connection that is never read."""

    def hold(self, queue: object) -> None:
        pass

    def release(self, queue: object) -> None:
        pass


def newest(waiting: deque[Any], packets: Sequence[Any], limit: int) -> tuple[Sequence[Any], int]:
    """Drop the new packets if the queue is full; the library has no such policy."""
    room = max(limit - len(waiting), 0)
    return packets[:room], len(packets) - len(packets[:room])


limits = st.integers(1, 6)
policies = st.one_of(
    st.just(latest),
    limits.map(drop_oldest),
    limits.map(lambda limit: Policy(limit, drop=None)),
    limits.map(lambda limit: Policy(limit, newest)),
)
#: Steps: the ages in s of packets that arrive together, or an action of the consumer.
steps = st.lists(
    st.one_of(st.lists(st.sampled_from([0.0, 2 * LIFESPAN]), max_size=9), st.sampled_from(["take", "end", "close"])),
    max_size=30,
)


def faces(policy: Policy) -> tuple[PacketQueue, LoopQueue]:
    connection: Any = Unread()
    return PacketQueue(policy, LIFESPAN), LoopQueue(policy, connection, LIFESPAN)


def counters(queue: BoundedQueue) -> tuple[int, ...]:
    return (queue.offered, queue.taken, queue.dropped, queue.expired, queue.overtaken, queue.waiting)


@pytest.mark.property
@given(policy=policies, steps=steps)
def test_thread_and_task_queues_behave_the_same(policy: Policy, steps: list[list[float] | str]) -> None:
    both = faces(policy)
    number = 0
    for step in steps:
        if isinstance(step, list):
            # In a single thread, a reader that waits for room would wait forever.
            room = policy.limit - both[0].waiting if policy.makes_reader_wait else len(step)
            packets = []
            for age in step[:room]:
                number += 1
                packets.append(Packet(number, Stamp(linkcore.clock.now() - age, 0.0)))
            for queue in both:
                queue.offer(packets)
        elif step == "take":
            threaded, looped = (queue.take() for queue in both)
            assert threaded is looped
        else:
            for queue in both:
                getattr(queue, step)()
        threaded_counters, looped_counters = map(counters, both)
        assert threaded_counters == looped_counters
        assert both[0].offered == both[0].taken + both[0].dropped + both[0].waiting
        assert both[0].is_over == both[1].is_over


@pytest.mark.parametrize("face", [0, 1], ids=["threads", "tasks"])
def test_custom_policy_selects_the_dropped_packets(face: int) -> None:
    queue = faces(Policy(2, newest))[face]
    queue.offer([Packet(number, Stamp.now()) for number in range(3)])
    queue.offer([Packet(3, Stamp.now())])
    assert [packet.number for packet in iter(queue.take, None)] == [0, 1]
    assert (queue.offered, queue.dropped) == (4, 2)


@pytest.mark.parametrize("face", [0, 1], ids=["threads", "tasks"])
def test_lossless_queue_keeps_packets_when_the_stream_closes(face: int) -> None:
    """A policy that makes the reader wait guarantees every packet; a policy that drops packets does not."""
    for policy, waiting in ((Policy(2, drop=None), 1), (Policy(2, newest), 0), (latest, 0)):
        fan_out, queue = FanOut(Packet), faces(policy)[face]
        fan_out.add(queue, Packet)
        fan_out.publish([Packet(0, Stamp.now())])
        fan_out.close(all=False)
        assert queue.waiting == waiting

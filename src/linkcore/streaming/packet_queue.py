"""The bounded queue between the thread that reads a stream and one consumer.

`queue.Queue` takes a lock and a condition for each packet, in Python, and can neither drop the oldest nor be ended.
Here the packets are in a `deque`, whose methods are atomic; a consumer that finds it empty sets a flag and sleeps on a
`SimpleQueue`, which is woken in C. So a packet that is handed over costs two method calls and a look at a flag, and
many packets cost hardly more than one.

The bound, the policy, the end and the counters are the same without threads: an asyncio consumer would take with
`next(0)` when its loop has been woken.
"""

from __future__ import annotations

import contextlib
import threading
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from queue import Empty, SimpleQueue
from typing import Any

from .. import clock
from ..arguments import check_seconds
from ..errors import BadValue


@dataclass(frozen=True)
class Policy:
    """How many packets wait for a subscriber, and what happens to one too many.

    Attributes:
        limit: packets that wait at most.
        evicts: True drops the oldest and counts it; False makes the reader wait.

    Raises:
        BadValue: a limit below 1.
    """

    limit: int
    evicts: bool

    def __post_init__(self) -> None:
        if self.limit < 1:
            raise BadValue(f"{self}: at least one packet has to fit")


#: Keep the newest packet only: for control loops and displays. A callback that is quick enough still gets every one.
latest = Policy(1, evicts=True)

#: Lose nothing: the reader waits, and with it every subscriber of the stream; in the end TCP makes the robot's
#: controller wait, which may then drop the connection. For replay and tests.
block = Policy(1024, evicts=False)


def drop_oldest(limit: int) -> Policy:
    """Let up to `limit` packets wait, then drop the oldest.

    Raises:
        BadValue: less than 1.
    """
    return Policy(limit, evicts=True)


def check_policy(value: Any) -> Policy:
    """`value`, if it is a policy.

    Raises:
        BadValue: it is not; says what is.
    """
    if not isinstance(value, Policy):
        raise BadValue(f"policy={value!r}; expected latest, drop_oldest(n) or block, the objects and not their names")
    return value


def check_lifespan(value: Any) -> float | None:
    """Seconds after its arrival for which a packet is worth having; None for ever.

    Raises:
        BadValue: it is not a positive number of seconds.
    """
    return None if value is None else check_seconds(value, "lifespan", positive=True)


def is_older(packet: Any, lifespan: float) -> bool:
    """Whether a packet arrived more than so many seconds ago, by the monotonic clock; one without a stamp did not."""
    received = packet.received
    return received is not None and clock.now() - received.monotonic > lifespan


class PacketQueue:
    """Packets waiting for one consumer; one thread offers them and one takes them.

    Whatever happens, ``offered == taken + dropped + waiting`` once both are at rest. Each counter is raised where its
    event happens, by one thread only or under a lock.

    Args:
        policy: what to do when the consumer falls behind.
        lifespan: seconds after its arrival (`received`) for which a packet can be taken; None for ever.

    Attributes:
        offered: packets that were offered to this queue.
        expired: those of `dropped` that were older than the lifespan when their turn came.
        evicts: drops the oldest when it is full, rather than making the reader wait.
        is_over: `next` has returned None because no more will come, or it was closed.
    """

    #: A queue is never in the way of another, so the reader serves it before the callbacks that it calls itself.
    is_inline = False

    def __init__(self, policy: Policy, lifespan: float | None = None) -> None:
        self.offered = 0
        self.expired = 0  # raised by the consumer
        self._lifespan = lifespan
        self.evicts = policy.evicts
        self._limit = policy.limit
        self._packets: deque[Any] = deque()
        self._evicted = 0  # raised by the reader
        self._discarded = 0  # raised under the lock
        self._discarding = threading.Lock()
        self._is_ended = False  # nothing more is to be taken from the reader
        self.is_over = False
        # A consumer that finds nothing raises its flag, looks again, and sleeps until a token comes; a thread that
        # changes something looks at the flag afterwards. So one of the two sees the other. A reader without room does
        # the same.
        self._consumer_sleeps = False
        self._reader_sleeps = False
        self._to_consumer: SimpleQueue[None] = SimpleQueue()
        self._to_reader: SimpleQueue[None] = SimpleQueue()

    @property
    def dropped(self) -> int:
        """Packets thrown away: one too many, too old, or waiting when the queue was closed."""
        return self._evicted + self._discarded + self.expired

    @property
    def overtaken(self) -> int:
        """Packets among `dropped` that newer ones replaced, or that had expired: the consumer fell behind."""
        return self._evicted + self.expired

    @property
    def waiting(self) -> int:
        """Packets in the queue."""
        return len(self._packets)

    # -- the reader's side ---------------------------------------------------------------------

    def offer(self, packets: Sequence[Any]) -> None:
        """Hand packets over; waits only under the policy `block`."""
        if self._is_ended:
            return
        count = len(packets)
        if count <= self._limit - len(self._packets):
            self.offered += count
            self._packets.extend(packets)
        elif self.evicts:
            self.offered += count
            self._evict(packets)
        else:
            self._wait_for_room(packets)
        if self._consumer_sleeps:
            self._consumer_sleeps = False
            self._to_consumer.put(None)
        if self.is_over:  # it was closed meanwhile, or its consumer has just gone
            self._discard()

    def _evict(self, packets: Sequence[Any]) -> None:
        """Make room by dropping the oldest: of those that wait, and then of those that come."""
        surplus = len(packets) - self._limit
        if surplus > 0:
            self._evicted += surplus
            packets = packets[surplus:]
        # Room is made first and the packets are added then: the other way round, a consumer that takes one in between
        # would have the newest dropped in its stead.
        for _ in range(len(self._packets) + len(packets) - self._limit):
            try:
                self._packets.popleft()
            except IndexError:  # the consumer was quicker
                break
            self._evicted += 1
        self._packets.extend(packets)

    def _wait_for_room(self, packets: Sequence[Any]) -> None:
        at = 0
        while at < len(packets):
            room = len(packets) if self.is_over else self._limit - len(self._packets)
            if room > 0:
                taken = packets[at : at + room]
                self.offered += len(taken)
                self._packets.extend(taken)
                at += room
                if self._consumer_sleeps:
                    self._consumer_sleeps = False
                    self._to_consumer.put(None)
                continue
            self._reader_sleeps = True
            if len(self._packets) >= self._limit and not self.is_over:
                self._to_reader.get()
            self._reader_sleeps = False

    def end(self) -> None:
        """No more will come; what waits can still be taken. Idempotent."""
        self._is_ended = True
        self._to_consumer.put(None)

    # -- the consumer's side -------------------------------------------------------------------

    def next(self, timeout: float | None = None) -> Any | None:
        """Wait for a packet and take it; None when time is up, or when no more will come: `is_over` tells which."""
        packets = self._packets
        until = None
        while True:
            if packets:
                try:
                    packet = packets.popleft()
                except IndexError:  # the reader has evicted it, and adds a newer one
                    continue
                # Not for each packet: the two threads would take turns.
                if self._reader_sleeps and len(packets) <= self._limit // 2:
                    self._reader_sleeps = False
                    self._to_reader.put(None)
                if self._lifespan is not None and is_older(packet, self._lifespan):
                    self.expired += 1
                    continue
                return packet
            if self._is_ended:
                self.is_over = True
                if packets:  # the reader was in the middle of an offer when the end came
                    continue
                return None
            if timeout is not None:
                now = clock.now()
                until = now + timeout if until is None else until
                if now >= until:
                    return None
            self._consumer_sleeps = True
            if not packets and not self._is_ended:
                # Most loops have no timeout. They need no call of `slice_of`, which would be one for each packet.
                left = clock.ENDLESS if until is None else clock.slice_of(until - now)
                with contextlib.suppress(Empty):
                    self._to_consumer.get(True, left)
            self._consumer_sleeps = False

    def close(self) -> None:
        """Drop what waits, take nothing more; idempotent."""
        self.is_over = True
        self.end()
        self._to_reader.put(None)
        self._discard()

    def _discard(self) -> None:
        # The reader, a thread that closes the queue and its signal handlers may all come here. Who finds the lock taken
        # need not wait: its holder looks again after releasing it.
        while self._packets and self._discarding.acquire(blocking=False):
            try:
                while self._packets:
                    try:
                        self._packets.popleft()
                    except IndexError:  # the consumer took it
                        break
                    self._discarded += 1
            finally:
                self._discarding.release()

"""The bounded queue between what reads a stream and one consumer, and what happens when it is full.

`BoundedQueue` has the bound, the policy, the lifespan, the end and the counters. It never waits. How a consumer waits
for a packet, and a reader for room, is the only difference between its two faces: `PacketQueue` for threads, and
`linkcore.aio.packets.LoopQueue` for tasks.

`queue.Queue` takes a lock and a condition for each packet, in Python, and can neither drop the oldest nor be ended.
Here the packets are in a `deque`, whose methods are atomic; a thread that finds it empty sets a flag and sleeps on a
`SimpleQueue`, which is woken in C. So a packet that is handed over costs a few method calls and a look at a flag, and
many packets cost hardly more than one.
"""

from __future__ import annotations

import abc
import contextlib
import threading
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from queue import Empty, SimpleQueue
from typing import Any

from .. import clock
from ..arguments import check_seconds
from ..errors import BadValue

#: Makes room for packets that do not all fit: ``drop(waiting, packets, limit)`` drops from either, and returns those
#: of `packets` that are to be added, and how many it has dropped. The consumer may take from `waiting` meanwhile.
Drop = Callable[[deque[Any], Sequence[Any], int], tuple[Sequence[Any], int]]


@dataclass(frozen=True)
class Policy:
    """How many packets wait for a subscriber, and what happens when more come.

    Attributes:
        limit: packets that wait at most.
        drop: makes room by dropping packets, which are counted; None makes the reader wait until there is room.

    Raises:
        BadValue: a limit below 1.
    """

    limit: int
    drop: Drop | None

    def __post_init__(self) -> None:
        if self.limit < 1:
            raise BadValue(f"{self}: at least one packet has to fit")

    @property
    def makes_reader_wait(self) -> bool:
        """Every packet is delivered, and the reader waits for a consumer that falls behind."""
        return self.drop is None


def _oldest(waiting: deque[Any], packets: Sequence[Any], limit: int) -> tuple[Sequence[Any], int]:
    """Drop the oldest: of those that wait, and then of those that come."""
    dropped = max(len(packets) - limit, 0)
    packets = packets[dropped:]
    # Room is made first and the packets are added then: the other way round, a consumer that takes one in between would
    # have the newest dropped in its stead.
    for _ in range(len(waiting) + len(packets) - limit):
        try:
            waiting.popleft()
        except IndexError:  # the consumer was quicker
            break
        dropped += 1
    return packets, dropped


def drop_oldest(limit: int) -> Policy:
    """Let up to `limit` packets wait, then drop the oldest.

    Raises:
        BadValue: less than 1.
    """
    return Policy(limit, _oldest)


#: Keep the newest packet only: for control loops and displays. A callback that is quick enough still gets every one.
latest = drop_oldest(1)

#: Lose nothing: the reader waits, and with it every subscriber of the stream; in the end TCP makes the robot's
#: controller wait, which may then drop the connection. For replay and tests.
block = Policy(1024, drop=None)


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


class BoundedQueue(abc.ABC):
    """Packets waiting for one consumer: what threads and tasks have in common. One offers them and one takes them.

    Whatever happens, ``offered == taken + dropped + waiting`` once both are at rest. Each counter is raised where its
    event happens, by one thread only or under a lock.

    Args:
        policy: what to do when the consumer falls behind.
        lifespan: seconds after its arrival (`received`) for which a packet can be taken; None for ever.

    Attributes:
        offered: packets that were offered to this queue.
        taken: packets that the consumer took.
        expired: those of `dropped` that were older than the lifespan when their turn came.
        makes_reader_wait: the reader waits when the queue is full, and no packet is dropped.
        is_over: No more will come, and what came was taken; or the queue was closed.
    """

    #: A queue is never in the way of another, so the reader serves it before the callbacks that it calls itself.
    is_inline = False

    def __init__(self, policy: Policy, lifespan: float | None = None) -> None:
        self.offered = 0
        self.taken = self.expired = 0  # raised by the consumer
        self.makes_reader_wait = policy.makes_reader_wait
        self.is_over = False
        self._lifespan = lifespan
        self._limit = policy.limit
        self._drop = policy.drop
        self._packets: deque[Any] = deque()
        self._surplus = 0  # dropped by the policy; raised by the reader
        self._discarded = 0  # raised under the lock
        self._discarding = threading.Lock()
        self._is_ended = False  # nothing more is to be taken from the reader
        self._consumer_sleeps = False
        self._reader_sleeps = False

    @property
    def dropped(self) -> int:
        """Packets thrown away: one too many, too old, or waiting when the queue was closed."""
        return self._surplus + self._discarded + self.expired

    @property
    def overtaken(self) -> int:
        """Packets among `dropped` that the policy dropped, or that had expired: the consumer fell behind."""
        return self._surplus + self.expired

    @property
    def waiting(self) -> int:
        """Packets in the queue."""
        return len(self._packets)

    @abc.abstractmethod
    def _wait_for_room(self, packets: Sequence[Any]) -> None:
        """Add packets of which not all fit, and make the reader wait."""

    @abc.abstractmethod
    def _wake_consumer(self) -> None:
        """There is something to take, or nothing will come any more."""

    @abc.abstractmethod
    def _wake_reader(self) -> None:
        """There is room, or no more is taken."""

    # -- the reader's side ---------------------------------------------------------------------

    def offer(self, packets: Sequence[Any]) -> None:
        """Hand packets over; the reader waits only if the policy says so."""
        if self._is_ended:
            return
        count = len(packets)
        if count <= self._limit - len(self._packets):
            self.offered += count
            self._packets.extend(packets)
        elif self._drop is not None:
            self.offered += count
            packets, dropped = self._drop(self._packets, packets, self._limit)
            self._surplus += dropped
            self._packets.extend(packets)
        else:
            self._wait_for_room(packets)
        if self._consumer_sleeps:
            self._wake_consumer()
        if self.is_over:  # it was closed meanwhile, or its consumer has just gone
            self._discard()

    def end(self) -> None:
        """No more will come; what waits can still be taken. Idempotent."""
        self._is_ended = True
        self._wake_consumer()

    # -- the consumer's side -------------------------------------------------------------------

    def take(self) -> Any | None:
        """A packet that has come and is not too old; None if there is none."""
        packets = self._packets
        while packets:
            try:
                packet = packets.popleft()
            except IndexError:  # the reader has dropped it, and adds a newer one
                continue
            # Not for each packet: the two would take turns.
            if self._reader_sleeps and len(packets) <= self._limit // 2:
                self._wake_reader()
            if self._lifespan is not None and is_older(packet, self._lifespan):
                self.expired += 1
                continue
            self.taken += 1
            return packet
        return None

    def close(self) -> None:
        """Drop what waits, take nothing more; idempotent."""
        self.is_over = True
        self.end()
        self._wake_reader()
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


class PacketQueue(BoundedQueue):
    """Packets waiting for one consumer in a thread of its own; the arguments are those of `BoundedQueue`.

    A consumer that finds nothing raises its flag, looks again, and sleeps until a token comes. A thread that changes
    something looks at the flag afterwards. So one of the two sees the other. A reader without room does the same.
    """

    def __init__(self, policy: Policy, lifespan: float | None = None) -> None:
        super().__init__(policy, lifespan)
        self._to_consumer: SimpleQueue[None] = SimpleQueue()
        self._to_reader: SimpleQueue[None] = SimpleQueue()

    def _wake_consumer(self) -> None:
        self._consumer_sleeps = False
        self._to_consumer.put(None)

    def _wake_reader(self) -> None:
        self._reader_sleeps = False
        self._to_reader.put(None)

    def _wait_for_room(self, packets: Sequence[Any]) -> None:
        at = 0
        while at < len(packets):
            room = len(packets) if self.is_over else self._limit - len(self._packets)
            if room > 0:
                added = packets[at : at + room]
                self.offered += len(added)
                self._packets.extend(added)
                at += room
                if self._consumer_sleeps:
                    self._wake_consumer()
                continue
            self._reader_sleeps = True
            if len(self._packets) >= self._limit and not self.is_over:
                self._to_reader.get()
            self._reader_sleeps = False

    def next(self, timeout: float | None = None) -> Any | None:
        """Wait for a packet and take it; None when time is up, or when no more will come: `is_over` tells which."""
        until = None
        while True:
            packet = self.take()
            if packet is not None:
                return packet
            if self._is_ended:
                self.is_over = True
                if self._packets:  # the reader was in the middle of an offer when the end came
                    continue
                return None
            if timeout is not None:
                now = clock.now()
                until = now + timeout if until is None else until
                if now >= until:
                    return None
            self._consumer_sleeps = True
            if not self._packets and not self._is_ended:
                # Most loops have no timeout. They need no call of `slice_of`, which would be one for each packet.
                left = clock.ENDLESS if until is None else clock.slice_of(until - now)
                with contextlib.suppress(Empty):
                    self._to_consumer.get(True, left)
            self._consumer_sleeps = False

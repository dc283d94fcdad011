"""Bounded queue between the reader of a stream and one consumer, and the policies for a full queue.

`BoundedQueue` implements the limit, the policy, the lifespan, the end and the counters. It never waits. Its two
subclasses implement two kinds of waiting, for packets and for room: `PacketQueue` is for threads, and
`linkcore.aio.packets.LoopQueue` is for tasks.

`queue.Queue` uses a lock and a condition for each packet, in Python. Such a queue can neither drop the oldest packet
nor be ended. In this module, the packets are in a `deque`, whose methods are atomic. If a thread finds the deque empty,
it sets a flag and sleeps on a `SimpleQueue`, which wakes it in C. So passing on a packet needs only a few method calls
and a check of a flag. Many packets take hardly longer than one packet.
"""

from __future__ import annotations

import abc
import threading
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from queue import Empty, SimpleQueue
from typing import Any

from .. import clock
from ..arguments import check_seconds
from ..errors import BadValue

#: Function that makes room when not all packets fit. ``drop(waiting, packets, limit)`` drops queued packets (`waiting`)
#: or new ones (`packets`). It returns the part of `packets` to add, and the number of dropped packets. The consumer may
#: remove packets from `waiting` at the same time.
Drop = Callable[[deque[Any], Sequence[Any], int], tuple[Sequence[Any], int]]


@dataclass(frozen=True)
class Policy:
    """Length of the queue of a subscriber, and its behaviour when it is full.

    Attributes:
        limit: Maximum number of queued packets.
        drop: Function that makes room by dropping packets, which are counted. With None, the reader waits for room.

    Raises:
        BadValue: If `limit` is below 1.
    """

    limit: int
    drop: Drop | None

    def __post_init__(self) -> None:
        if self.limit < 1:
            raise BadValue(f"{self}; expected a limit of 1 or more packets")

    @property
    def makes_reader_wait(self) -> bool:
        """Whether every packet is delivered, and the reader waits for a consumer that falls behind."""
        return self.drop is None


def _oldest(waiting: deque[Any], packets: Sequence[Any], limit: int) -> tuple[Sequence[Any], int]:
    """Drop the oldest packets: first the queued ones, then the new ones."""
    dropped = max(len(packets) - limit, 0)
    packets = packets[dropped:]
    # Room is made before the packets are added. In the other order, if the consumer took a packet in between, the
    # newest packet would be dropped.
    for _ in range(len(waiting) + len(packets) - limit):
        try:
            waiting.popleft()
        except IndexError:  # the consumer has already taken it
            break
        dropped += 1
    return packets, dropped


def drop_oldest(limit: int) -> Policy:
    """Return a policy that queues up to `limit` packets, and then drops the oldest ones.

    Raises:
        BadValue: If `limit` is below 1.
    """
    return Policy(limit, _oldest)


#: Policy that keeps only the newest packet, for control loops and displays. A quick callback still gets every packet.
latest = drop_oldest(1)

#: Policy that never drops a packet. If the queue is full, the reader waits, and with it every subscriber of the stream.
#: In the end TCP makes the robot's controller wait, and the controller might then drop the connection. Use it for
#: replay and tests.
block = Policy(1024, drop=None)


def check_policy(value: Any) -> Policy:
    """Return `value` if it is a policy.

    Raises:
        BadValue: If it is not a policy. The message lists the policies.
    """
    if not isinstance(value, Policy):
        raise BadValue(f"policy={value!r}; expected latest, drop_oldest(n) or block, as objects rather than names")
    return value


def check_lifespan(value: Any) -> float | None:
    """Return the maximum age of a packet in s; None for no limit.

    Raises:
        BadValue: If `value` is not a positive number of seconds.
    """
    return None if value is None else check_seconds(value, "lifespan", positive=True)


def is_older(packet: Any, lifespan: float) -> bool:
    """Whether a packet arrived more than `lifespan` seconds ago.

    Return False for a packet without a stamp.
    """
    received = packet.received
    return received is not None and clock.now() - received.monotonic > lifespan


class BoundedQueue(abc.ABC):
    """Queue with one producer and one consumer: common base class of the queues for threads and for tasks.

    When both sides are idle, ``offered == taken + dropped + waiting`` always holds. Each counter is incremented where
    its event happens, by only one thread or under a lock.

    Args:
        policy: Behaviour when the consumer falls behind.
        lifespan: Seconds after its arrival (`received`) for which a packet can be taken; None for no limit.

    Attributes:
        offered: Number of packets that were offered to this queue.
        taken: Number of packets that the consumer took.
        expired: Number of packets among `dropped` that were older than the lifespan when they would have been
            delivered.
        makes_reader_wait: Whether the reader waits when the queue is full, so that no packet is dropped.
        is_over: Whether the queue was closed, or no more packets will arrive and all were taken.
        take_in_place: Function that processes one steady packet of a simulated peer in place of the consumer, which
            currently waits. It must neither wait nor raise an exception. It returns False if the consumer must process
            the packet. None if there is no such function.
        taken_in_place: Number of packets among `taken` that `take_in_place` has processed.
    """

    #: A queue never delays another queue, so the reader serves queues before the callbacks that it calls itself.
    is_inline = False

    def __init__(self, policy: Policy, lifespan: float | None = None) -> None:
        self.offered = 0
        self.taken = self.expired = 0  # incremented by the consumer
        self.makes_reader_wait = policy.makes_reader_wait
        self.is_over = False
        self.take_in_place: Callable[[Any], bool] | None = None
        self.taken_in_place = 0  # incremented by the reader, while the consumer waits
        self._lifespan = lifespan
        self._limit = policy.limit
        self._drop = policy.drop
        self._packets: deque[Any] = deque()
        self._surplus = 0  # packets dropped by the policy; incremented by the reader
        self._discarded = 0  # packets dropped at the end; incremented under the lock
        self._discarding = threading.Lock()
        self._is_ended = False  # whether no more packets are accepted from the reader
        self._consumer_sleeps = False
        self._reader_sleeps = False

    @property
    def dropped(self) -> int:
        """Packets that were dropped by the policy, had expired, or were still queued at the close."""
        return self._surplus + self._discarded + self.expired

    @property
    def overtaken(self) -> int:
        """Packets among `dropped` that the policy dropped or that had expired, because the consumer fell behind."""
        return self._surplus + self.expired

    @property
    def waiting(self) -> int:
        """Packets in the queue."""
        return len(self._packets)

    @abc.abstractmethod
    def _wait_for_room(self, packets: Sequence[Any]) -> None:
        """Add packets that do not all fit, and make the reader wait for room."""

    @abc.abstractmethod
    def _wake_consumer(self) -> None:
        """Wake the consumer, because there is a packet, or no more packets will arrive."""

    @abc.abstractmethod
    def _wake_reader(self) -> None:
        """Wake the reader, because there is room, or no more packets are accepted."""

    # -- the reader's side ---------------------------------------------------------------------

    def offer(self, packets: Sequence[Any]) -> None:
        """Add packets. The reader waits for room only if the policy requires it."""
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
        if self.is_over:  # it was closed meanwhile, or its consumer has just ended
            self._discard()

    def offer_steady(self, packets: Sequence[Any]) -> None:
        """Do the same for steady packets. `take_in_place` might process a single packet."""
        take = self.take_in_place
        is_waiting = self._consumer_sleeps and not (self._packets or self._is_ended)
        if take is None or not is_waiting or len(packets) > 1 or not take(packets[0]):
            self.offer(packets)
        else:
            self.offered += 1
            self.taken += 1
            self.taken_in_place += 1

    def end(self) -> None:
        """Accept no more packets; queued packets can still be taken. Idempotent."""
        self._is_ended = True
        self._wake_consumer()

    # -- the consumer's side -------------------------------------------------------------------

    def take(self) -> Any | None:
        """Remove and return the next packet that has not expired; None if there is none."""
        packets = self._packets
        while packets:
            try:
                packet = packets.popleft()
            except IndexError:  # the reader has dropped it, and will add a newer one
                continue
            # Wake the reader only when half of the queue is free: otherwise both threads would alternate.
            if self._reader_sleeps and len(packets) <= self._limit // 2:
                self._wake_reader()
            if self._lifespan is not None and is_older(packet, self._lifespan):
                self.expired += 1
                continue
            self.taken += 1
            return packet
        return None

    def close(self) -> None:
        """Drop the queued packets, and accept no more; idempotent."""
        self.is_over = True
        self.end()
        self._wake_reader()
        self._discard()

    def _discard(self) -> None:
        # The reader, a thread that closes the queue, and its signal handlers may all call this. If the lock is taken, a
        # caller does not have to wait, because the holder checks the queue again after releasing the lock.
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
    """Queue for a consumer in another thread. See `BoundedQueue` for the arguments.

    A consumer that finds no packet sets its flag, checks the queue again, and sleeps until a token arrives. A thread
    that changes the queue checks the flag afterwards. So at least one of the two threads notices the other. A reader
    that waits for room does the same.
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
        """Wait for a packet, and return it; return None after `timeout`, or when `is_over` is true."""
        until = None
        while True:
            packet = self.take() if self._packets else None
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
                # Most loops have no timeout, so this saves them a call of `slice_of` for each packet.
                left = clock.ENDLESS if until is None else clock.slice_of(until - now)
                # `contextlib.suppress` costs 3,900 instructions, and this runs for each packet.
                try:  # noqa: SIM105
                    self._to_consumer.get(True, left)
                except Empty:
                    pass
            self._consumer_sleeps = False

"""Packets for a task: a bounded queue that an event loop fills, and an asynchronous iterator over this queue."""

from __future__ import annotations

import asyncio
import contextlib
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from ..errors import LocalError
from ..names import StrictAttributes
from ..streaming.feed import Feed
from ..streaming.packet_queue import BoundedQueue, Policy
from ..streaming.statistics import SubscriptionStatistics
from .loop_connection import LoopConnection

if TYPE_CHECKING:
    from typing_extensions import Self

T = TypeVar("T")


class LoopQueue(BoundedQueue):
    """Queue of packets for one task. Everything happens in the thread of the loop.

    Args:
        policy: Behaviour when the task falls behind. If the policy makes the reader wait, the loop stops reading from
            this peer when the queue is full, and continues when the queue is half empty. Bytes that were read at the
            same moment, at most 64 KiB, are still accepted, so the queue can exceed the limit by about 60 packets.
        connection: Connection that is not read while the queue is full.
        lifespan: Maximum age of a packet in seconds after its arrival; None for no limit.
    """

    def __init__(self, policy: Policy, connection: LoopConnection, lifespan: float | None = None) -> None:
        super().__init__(policy, lifespan)
        self._connection = connection
        self._waiter: asyncio.Future[None] | None = None

    def offer(self, packets: Sequence[Any]) -> None:
        """Add packets."""
        super().offer(packets)
        # A full queue must stop the reading at once, because the next packets could not be rejected.
        if self.makes_reader_wait and len(self._packets) >= self._limit and not self._is_ended:
            self._reader_sleeps = True
            self._connection.hold(self)

    def _wait_for_room(self, packets: Sequence[Any]) -> None:
        self.offered += len(packets)
        self._packets.extend(packets)

    def _wake_consumer(self) -> None:
        self._consumer_sleeps = False
        if self._waiter is not None and not self._waiter.done():
            self._waiter.set_result(None)

    def _wake_reader(self) -> None:
        self._reader_sleeps = False
        self._connection.release(self)

    async def next(self, timeout: float | None = None) -> Any | None:
        """Wait for a packet, and return it; return None after `timeout`, or when `is_over` is true.

        Raises:
            LocalError: If another task is already waiting for a packet.
        """
        timer: asyncio.TimerHandle | None = None
        is_late = False

        def time_is_up() -> None:
            nonlocal is_late
            self._connection.look()  # packets might have arrived while the loop was blocked
            is_late = True
            self._wake_consumer()

        if self._waiter is not None:
            raise LocalError(
                "another task is already waiting for a packet of this iterator; use a separate iterator for each task"
            )
        loop = asyncio.get_running_loop()
        try:
            while (packet := self.take()) is None:
                if self._is_ended:
                    self.is_over = True
                    return None
                if is_late:
                    return None
                if timeout is not None and timer is None:
                    timer = loop.call_later(timeout, time_is_up)
                self._waiter = loop.create_future()
                self._consumer_sleeps = True
                await self._waiter
        finally:
            self._waiter = None
            self._consumer_sleeps = False
            if timer is not None:
                timer.cancel()
        return packet


class Packets(StrictAttributes, Generic[T]):
    """Iterator over the packets of one class, returned by `AsyncFeed.iterate`, for a single ``async for``.

    The iterator begins to queue packets at its first step. It ends when the stream ends, or with `aclose`. If a task is
    cancelled while it waits, no packet is lost: the next step returns the packet.

    Args:
        connection: Connection of the packets.
        feed: Feed for threads. It contains the class of the packets, and makes the error messages.
        policy: Behaviour when the task falls behind.
        timeout: Maximum wait for each packet in seconds; None for no limit.
        lifespan: Maximum age of a packet in seconds after its arrival; None for no limit.
        is_loop: Whether `Stream.stats` counts packets that are dropped because the task falls behind.
    """

    def __init__(
        self,
        connection: LoopConnection,
        feed: Feed[T],
        policy: Policy,
        timeout: float | None,
        lifespan: float | None,
        *,
        is_loop: bool,
    ) -> None:
        self._connection = connection
        self._feed = feed  # prevents the garbage collection of the stream
        self._timeout = timeout
        self._expand: Callable[[Any], Iterable[T]] | None = connection.fan_out.expander(feed._kind)
        self._queue = LoopQueue(policy, connection, lifespan)
        self._is_loop = is_loop
        self._parts: deque[T] = deque()  # remaining parts of the last packet
        self._is_open = False
        self._missed = 0

    @property
    def stats(self) -> SubscriptionStatistics:
        """Counters at this moment; ``offered == delivered + dropped + waiting``."""
        queue = self._queue
        return SubscriptionStatistics(
            queue.offered, queue.taken, queue.dropped, 0, queue.waiting, self._missed, queue.expired
        )

    def __aiter__(self) -> Self:
        return self

    async def __anext__(self) -> T:
        packet = await self.next(self._timeout)
        if packet is not None:
            return packet
        if self._queue.is_over:
            await self.aclose()
            if self._connection.failure is not None:
                raise self._connection.failure
            raise StopAsyncIteration
        assert self._timeout is not None
        self._missed += 1
        raise self._feed._why_nothing(self._timeout)

    async def next(self, timeout: float | None) -> T | None:
        """Return the next packet; return None after `timeout`, or if no more packets will arrive.

        Raises:
            RemoteError, Closed: If the first connection cannot be made.
            LocalError: If another task is already waiting for a packet.
        """
        if self._parts:
            return self._parts.popleft()
        if not self._is_open:
            await self.open()
        packet = self._queue.take()
        if packet is None:
            packet = await self._queue.next(timeout)
        if packet is None or self._expand is None:
            return packet
        self._parts.extend(self._expand(packet))
        return self._parts.popleft()

    async def open(self) -> None:
        """Connect if the stream has not connected yet, and begin to queue packets.

        Raises:
            RemoteError, Closed: If the first connection cannot be made.
        """
        connection = self._connection
        self._is_open = True
        try:
            await connection.connected(lambda: connection.fan_out.add(self._queue, self._feed._kind))
        except BaseException:
            self._is_open = False
            connection.fan_out.remove(self._queue)
            raise
        if self._is_loop:
            connection.counters.loop_began(self._queue)
        if connection.is_over:
            self._queue.end()

    async def aclose(self) -> None:
        """Stop accepting packets. Queued packets are dropped and counted. Idempotent."""
        self._connection.fan_out.remove(self._queue)
        self._queue.close()
        self._connection.counters.loop_ended(self._queue)

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, *exc: object) -> None:
        await self.aclose()

    def __del__(self) -> None:
        # The program has left the iteration before its end, so nothing can take the next packets.
        if getattr(self, "_is_open", False):
            connection, queue = self._connection, self._queue
            connection.fan_out.remove(queue)
            connection.counters.loop_ended(queue)
            with contextlib.suppress(LocalError):  # the loop is closed
                connection.call(queue.close)  # the garbage collector may run in another thread

    def __repr__(self) -> str:
        stats = self.stats
        counted = ", ".join(f"{getattr(stats, name)} {name}" for name in ("delivered", "dropped", "waiting"))
        return f"<Packets of {self._feed._kind.__name__} from {self._connection.name}: {counted}>"

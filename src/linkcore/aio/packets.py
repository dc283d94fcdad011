"""Packets as a task takes them: a bounded queue that an event loop fills, and an asynchronous iterator over it."""

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
    """Packets waiting for one task. Everything happens in the thread of the loop.

    Args:
        policy: what to do when the task falls behind. If it makes the reader wait, the loop reads no more from this
            peer when the queue is full, until it is half empty. What was read in the same moment, at most 64 KiB, is
            still taken in, so up to some 60 packets more than the limit can wait.
        connection: is read no more when the queue is full.
        lifespan: seconds after its arrival for which a packet can be taken; None for ever.
    """

    def __init__(self, policy: Policy, connection: LoopConnection, lifespan: float | None = None) -> None:
        super().__init__(policy, lifespan)
        self._connection = connection
        self._waiter: asyncio.Future[None] | None = None

    def offer(self, packets: Sequence[Any]) -> None:
        """Hand packets over."""
        super().offer(packets)
        # A full queue has to say so at once: what the loop reads next could not be refused.
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
        """Wait for a packet and take it; None when time is up, or when no more will come: `is_over` tells which.

        Raises:
            LocalError: another task waits here.
        """
        timer: asyncio.TimerHandle | None = None
        is_late = False

        def time_is_up() -> None:
            nonlocal is_late
            self._connection.look()  # the loop may have been held up while packets came
            is_late = True
            self._wake_consumer()

        if self._waiter is not None:
            raise LocalError("another task waits for packets of this iterator; give each task one of its own")
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
    """Packets of one class, one after the other; made by `AsyncFeed.iterate`, for one ``async for``.

    It begins with the first step, and ends with the loop, or with `aclose`. A task that is cancelled while it waits
    loses no packet: the next step has it.

    Args:
        connection: where they come from.
        feed: the same for threads; it has the class, and what to raise where none came.
        policy: what to do when the task falls behind.
        timeout: seconds within which each has to come; None for ever.
        lifespan: seconds after its arrival for which a packet is worth having; None for ever.
        is_loop: Whether `Stream.stats` counts what is dropped because the task falls behind.
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
        self._feed = feed  # keeps the stream from being collected
        self._timeout = timeout
        self._expand: Callable[[Any], Iterable[T]] | None = connection.fan_out.expander(feed._kind)
        self._queue = LoopQueue(policy, connection, lifespan)
        self._is_loop = is_loop
        self._parts: deque[T] = deque()  # of the packet that was taken last
        self._is_open = False
        self._missed = 0

    @property
    def stats(self) -> SubscriptionStatistics:
        """The counters at this moment; ``offered == delivered + dropped + waiting``."""
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
        """The next packet; None when time is up, or when no more will come.

        Raises:
            RemoteError, Closed: the first connection could not be made.
            LocalError: another task waits here.
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
        """Connect, if nothing has yet; from now on no packet is missed.

        Raises:
            RemoteError, Closed: the first connection could not be made.
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
        """Take no more; what waits is dropped and counted. Idempotent."""
        self._connection.fan_out.remove(self._queue)
        self._queue.close()
        self._connection.counters.loop_ended(self._queue)

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, *exc: object) -> None:
        await self.aclose()

    def __del__(self) -> None:
        # A loop that was left before its end: nobody can take what comes any more.
        if getattr(self, "_is_open", False):
            connection, queue = self._connection, self._queue
            connection.fan_out.remove(queue)
            connection.counters.loop_ended(queue)
            with contextlib.suppress(LocalError):  # the loop is closed
                connection.call(queue.close)  # this may be a thread that collects garbage

    def __repr__(self) -> str:
        stats = self.stats
        counted = ", ".join(f"{getattr(stats, name)} {name}" for name in ("delivered", "dropped", "waiting"))
        return f"<Packets of {self._feed._kind.__name__} from {self._connection.name}: {counted}>"

"""Classes `AsyncFeed` and `AsyncStream`: the packets of one interface, for programs that use asyncio."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any, Generic, TypeVar

from .. import clock
from ..arguments import check_callable, check_seconds
from ..names import StrictAttributes
from ..streaming.connection_life import ConnectionState
from ..streaming.feed import LAGGARD, Feed
from ..streaming.history import History
from ..streaming.packet_queue import Policy, check_lifespan, drop_oldest, latest
from ..streaming.statistics import StreamStatistics
from ..streaming.stream import Stream
from ..streaming.subscription import Subscription, check_deadline
from .loop_connection import LoopConnection
from .packets import Packets

T = TypeVar("T")
K = TypeVar("K")

#: Time in s for which the window of a live plot processes its events while the loop waits.
_EVENTS = 1e-3


class AsyncFeed(StrictAttributes, Generic[T]):
    """The packets of one class on a stream: iterate, wait, read the newest, or subscribe.

    `AsyncStream.of` returns a feed. A stream is itself the feed of its main class. Only tasks of the loop that reads
    the stream may use the feed.

    Args:
        feed: The same feed for threads. It makes the error messages, and prevents the garbage collection of the stream.
    """

    __slots__ = ("_feed", "_kind", "_loop_connection")

    def __init__(self, feed: Feed[T]) -> None:
        assert isinstance(feed._connection, LoopConnection)
        self._feed = feed
        self._loop_connection = feed._connection
        self._kind = feed._kind

    def _hint(self, name: str) -> str | None:
        return self._feed._hint(name)

    @property
    def latest(self) -> T | None:
        """Newest packet of the current connection, or None. Never waits; see `Feed.latest`."""
        return self._feed.latest

    async def wait(self, timeout: float = 5.0) -> T:
        """Wait for the next packet, and return it.

        Args:
            timeout: Maximum wait in seconds.

        Raises:
            BadValue: If `timeout` is not a number of seconds.
            LinkTimeout: If no packet arrives within `timeout` seconds.
            RemoteError: If the first connection cannot be made, or the stream has stopped reconnecting.
            Closed: If the stream was closed.
        """
        timeout = check_seconds(timeout, "timeout")
        async with self._packets(latest, timeout) as packets:
            async for packet in packets:
                return packet
        raise self._feed._why_nothing(timeout)

    async def wait_until(self, condition: Callable[[T], object], timeout: float = 5.0) -> T:
        """Wait for a packet that meets a condition, and return it.

        The newest packet is examined first, then every packet as it arrives, all in the thread of the loop. For events
        (`State.IS_EVENT`), only events that arrive from now on are examined.

        Args:
            condition: Function that is called with each packet. An exception that it raises ends the wait.
            timeout: Maximum wait in seconds.

        Raises:
            BadValue: If `condition` is not callable, or `timeout` is not a number of seconds.
            LinkTimeout: If no packet meets the condition within `timeout` seconds; the message contains the number of
                examined packets.
            RemoteError, Closed: See `wait`.
        """
        check_callable(condition, "condition")
        timeout = check_seconds(timeout, "timeout")
        end = clock.now() + timeout
        looked_at = 0
        async with self._packets(drop_oldest(LAGGARD), timeout) as packets:
            await packets.open()
            newest = None if self._feed._has_events else self.latest
            if newest is not None and condition(newest):
                return newest
            while (packet := await packets.next(clock.left(end))) is not None:
                looked_at += 1
                if condition(packet):
                    return packet
        raise self._feed._why_none_of(looked_at, timeout)

    def iterate(
        self, policy: Policy | None = None, timeout: float | None = None, lifespan: float | None = None
    ) -> Packets[T]:
        """Iterate over the packets with your own policy or timeout.

        A plain ``async for`` keeps only the newest state, or 1024 events. The iteration ends when the stream is closed,
        or has stopped reconnecting. Without a timeout, it waits for a disconnected robot for as long as the back-off
        allows; a `ConnectionEvent` reports the disconnection.

        Args:
            policy: `latest`, `drop_oldest(n)` or `block`. With `block`, no packet is dropped: while the task is late,
                the loop does not read from this robot.
            timeout: Maximum wait for each packet, in seconds.
            lifespan: Maximum age of a packet in seconds after its arrival; None for no limit. If a packet is older than
                this when it would be delivered, it is dropped and counted as `expired`.

        Returns:
            The iterator. Its attribute `stats` counts the offered, delivered and dropped packets. `AsyncStream.stats`
            counts packets that were dropped because a loop was slow, as `dropped`.

        Raises:
            BadValue: If `policy` is not a policy, or a time is not a number of seconds.
            LinkTimeout: If no packet arrives within `timeout` seconds.
            RemoteError: If the first connection cannot be made, or the stream has stopped reconnecting.
        """
        policy = self._feed._policy(policy, latest)
        if timeout is not None:
            timeout = check_seconds(timeout, "timeout")
        lifespan = check_lifespan(lifespan)
        return Packets(self._loop_connection, self._feed, policy, timeout, lifespan, is_loop=True)

    def _packets(self, policy: Policy, timeout: float) -> Packets[T]:
        return Packets(self._loop_connection, self._feed, policy, timeout, None, is_loop=False)

    def __aiter__(self) -> Packets[T]:
        return self.iterate()

    async def subscribe(
        self,
        callback: Callable[[T], object],
        *,
        deadline: float | None = None,
        on_deadline: Callable[[float], object] | None = None,
    ) -> Subscription:
        """Call `callback` with each packet, in order, in the thread of the loop, until the subscription is closed.

        The callback must be quick and must not wait, because the loop does nothing else until it returns. Calls of more
        than 0.5 ms are counted in `AsyncStream.stats`. An exception in the callback is logged and counted, and the
        callback is called again for the next packet.

        Args:
            callback: Function that is called with each packet.
            deadline: See `Feed.subscribe`.
            on_deadline: See `Feed.subscribe`. It is also called in the thread of the loop.

        Raises:
            BadValue: If an argument is invalid.
            RemoteError: If the first connection cannot be made.
            Closed: If the stream was closed.
        """
        check_callable(callback, "callback")
        deadline = check_deadline(deadline, on_deadline)
        connection = self._loop_connection
        await connection.connected()
        late = None if on_deadline is None else lambda age: connection.call(lambda: on_deadline(age))
        return connection.subscribe_inline(
            self._kind, callback, deadline=deadline, on_deadline=late, owner=self._feed._owner
        )

    async def history(self, seconds: float) -> History:
        """Keep the states of the last seconds: ``with await robot.realtime.history(5) as history:``.

        See `Feed.history`.

        Raises:
            BadValue, RemoteError, Closed: See `Feed.history`.
        """
        await self._loop_connection.connected()
        return self._feed.history(seconds)

    async def plot(self, *fields: str, seconds: float = 10.0, window: float = 10.0, period: float = 0.2) -> None:
        """Plot fields while they arrive; see `Feed.plot`.

        The loop does nothing else while a plot is drawn, which takes tens of milliseconds.

        Raises:
            BadValue, LocalError, LinkTimeout, RemoteError, Closed: See `Feed.plot`.
        """
        from ..streaming.plotting import LivePlot  # imported here: importing the library stays fast

        seconds = check_seconds(seconds, "seconds", positive=True, finite=True)
        period = check_seconds(period, "period", positive=True, finite=True)
        live = LivePlot()
        try:
            with await self.history(window) as history:
                end = clock.now() + seconds
                for picture in self._feed._pictures(history, fields, end):
                    if picture is None:
                        await self.wait(clock.left(end))
                    else:
                        live.update(picture, _EVENTS)
                        await asyncio.sleep(min(period, clock.left(end)))
                if not len(history):
                    raise self._feed._why_nothing(seconds)
        finally:
            live.close()

    def __repr__(self) -> str:
        return f"<AsyncFeed of {self._kind.__name__} from {self._loop_connection.name}>"


class AsyncStream(AsyncFeed[T]):
    """The packets of one interface of a robot, for programs that use asyncio.

    Example: ``async for state in robot.realtime``. The event loop reads the stream, without a thread. The stream
    connects when it is first used. When the connection is lost, the stream reconnects automatically; its iterators and
    subscriptions continue.

    Attributes:
        stream: The same stream for other threads. It uses the connection that the loop reads.
    """

    __slots__ = ("stream",)

    def __init__(self, stream: Stream[T]) -> None:
        super().__init__(stream)
        self.stream = stream

    @property
    def name(self) -> str:
        """Address and interface."""
        return self.stream.name

    @property
    def connection(self) -> ConnectionState:
        """Current state of the connection."""
        return self.stream.connection

    @property
    def failure(self) -> Exception | None:
        """Error that ended the stream; None if it was closed on purpose, or has not ended."""
        return self.stream.failure

    @property
    def stats(self) -> StreamStatistics:
        """Counters at this moment."""
        return self.stream.stats

    async def start(self) -> None:
        """Connect if the stream has not connected yet, and wait until it is connected.

        Raises:
            RemoteError: If the connection cannot be made; the next use tries again.
            Closed: If the stream was closed.
        """
        await self._loop_connection.connected()

    def of(self, kind: type[K]) -> AsyncFeed[K]:
        """Return the feed of another class of packets on the same stream; see `Stream.of`.

        Raises:
            BadValue: If packets of this class cannot arrive on this stream.
        """
        return AsyncFeed(self.stream.of(kind))

    async def subscribe(
        self,
        callback: Callable[[Any], object],
        kind: type | None = None,
        *,
        deadline: float | None = None,
        on_deadline: Callable[[float], object] | None = None,
    ) -> Subscription:
        """Subscribe as with `AsyncFeed.subscribe`; with `kind`, to the packets of this class."""
        if kind is None:
            return await super().subscribe(callback, deadline=deadline, on_deadline=on_deadline)
        feed: AsyncFeed[Any] = self.of(kind)
        return await feed.subscribe(callback, deadline=deadline, on_deadline=on_deadline)

    async def description(self) -> dict[str, Any]:
        """Return the description for a recording; see `Stream.description`."""
        return self.stream.description()

    async def join(self, timeout: float | None = None) -> bool:
        """Wait until the stream is closed, or has stopped reconnecting.

        Return False after `timeout` seconds. If the stream has not connected yet, the call returns at once.

        Args:
            timeout: Maximum wait in seconds; None for no limit.

        Raises:
            BadValue: If `timeout` is not a number of seconds.
        """
        return await self._loop_connection.joined(None if timeout is None else check_seconds(timeout, "timeout"))

    async def close(self) -> None:
        """Disconnect and end every iterator and subscription. Idempotent.

        Queued packets are dropped and counted. Under the policy `block` they can still be taken.
        """
        await self._loop_connection.disconnected()

    async def __aenter__(self) -> AsyncStream[T]:
        return self

    async def __aexit__(self, *exc: object) -> None:
        await self.close()

    def __repr__(self) -> str:
        return f"<Async{repr(self.stream).removeprefix('<')}"

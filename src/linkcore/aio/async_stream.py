"""`AsyncFeed` and `AsyncStream`: the packets of one interface, for programs that use asyncio."""

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

#: Seconds that a live plot's window has for its events; the loop waits for them.
_EVENTS = 1e-3


class AsyncFeed(StrictAttributes, Generic[T]):
    """The packets of one class on a stream: iterate, wait for the next, look at the newest, be called back.

    Made by `AsyncStream.of`; a stream is the feed of its main class. For tasks of the loop that reads the stream.

    Args:
        feed: the same for threads; it has the texts of its errors, and keeps the stream from being collected.
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
        """The newest packet of this connection, or None. Never waits; see `Feed.latest`."""
        return self._feed.latest

    async def wait(self, timeout: float = 5.0) -> T:
        """The next packet that arrives.

        Raises:
            BadValue: `timeout` is not a number of seconds.
            LinkTimeout: none came within `timeout` seconds.
            RemoteError: the first connection could not be made, or the stream gave up.
            Closed: the stream was closed.
        """
        timeout = check_seconds(timeout, "timeout")
        async with self._packets(latest, timeout) as packets:
            async for packet in packets:
                return packet
        raise self._feed._why_nothing(timeout)

    async def wait_until(self, condition: Callable[[T], object], timeout: float = 5.0) -> T:
        """The first packet for which a condition holds: the newest that there is, or one that arrives.

        Every packet is looked at as it comes, in the thread of the loop. Of events (`State.IS_EVENT`) only those count
        that arrive from now on.

        Args:
            condition: gets each packet; what it raises ends the waiting.
            timeout: seconds.

        Raises:
            BadValue: `condition` cannot be called, or `timeout` is not a number of seconds.
            LinkTimeout: it did not hold within `timeout` seconds; the message says how many packets there were.
            RemoteError, Closed: as `wait`.
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
        """Iterate with a policy or a timeout of your own; a plain ``async for`` keeps the newest state, or 1024 events.

        Ends when the stream is closed, or given up. Without a timeout it waits for as long as the back-off allows for a
        robot that went away; `ConnectionEvent` tells of that.

        Args:
            policy: `latest`, `drop_oldest(n)`, or `block`, under which nothing is lost: the loop reads no more from
                this robot while the task is behind.
            timeout: seconds within which each packet has to come.
            lifespan: seconds after its arrival for which a packet is worth having; None for ever. One that is older
                when its turn comes is dropped and counted as `expired`.

        Returns:
            The iterator; its `stats` count what was offered, delivered and dropped. `AsyncStream.stats` counts what
            slow loops drop, as `dropped`.

        Raises:
            BadValue: no policy, or no number of seconds.
            LinkTimeout: nothing came within `timeout` seconds.
            RemoteError: the first connection could not be made, or the stream gave up.
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
        """Call `callback` with each packet, in order, in the thread of the loop, until closed.

        It has to be quick and must not wait: until it returns, the loop does nothing else. Calls of more than 0.5 ms
        are counted in `AsyncStream.stats`. What it raises is logged and counted, and it is called again.

        Args:
            callback: gets each packet.
            deadline, on_deadline: as for `Feed.subscribe`; `on_deadline` is called in the thread of the loop too.

        Raises:
            BadValue: an argument is not what it should be.
            RemoteError: the first connection could not be made.
            Closed: the stream was closed.
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
        """As `Feed.history`: ``with await robot.realtime.history(5) as history:``.

        Raises:
            BadValue, RemoteError, Closed: as `Feed.history`.
        """
        await self._loop_connection.connected()
        return self._feed.history(seconds)

    async def plot(self, *fields: str, seconds: float = 10.0, window: float = 10.0, period: float = 0.2) -> None:
        """As `Feed.plot`. The loop does nothing else while a picture is drawn, which takes tens of milliseconds.

        Raises:
            BadValue, LocalError, LinkTimeout, RemoteError, Closed: as `Feed.plot`.
        """
        from ..plotting import LivePlot  # imported here: importing the library stays cheap

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
    """The packets of one interface of one robot, for programs that use asyncio: ``async for state in robot.realtime``.

    The event loop reads it; there is no thread. Connects when first used, connects again by itself when the connection
    is lost, and keeps its iterators and subscriptions meanwhile.

    Attributes:
        stream: the same for other threads, over the connection that the loop reads.
    """

    __slots__ = ("stream",)

    def __init__(self, stream: Stream[T]) -> None:
        super().__init__(stream)
        self.stream = stream

    @property
    def name(self) -> str:
        """The address and the interface."""
        return self.stream.name

    @property
    def connection(self) -> ConnectionState:
        """What the connection is doing."""
        return self.stream.connection

    @property
    def failure(self) -> Exception | None:
        """What ended the stream, where it was not closed on purpose."""
        return self.stream.failure

    @property
    def stats(self) -> StreamStatistics:
        """The counters at this moment."""
        return self.stream.stats

    async def start(self) -> None:
        """Connect, if nothing has yet, and wait until it is done.

        Raises:
            RemoteError: the connection could not be made; the next use tries again.
            Closed: the stream was closed.
        """
        await self._loop_connection.connected()

    def of(self, kind: type[K]) -> AsyncFeed[K]:
        """The packets of another class on the same stream; see `Stream.of`.

        Raises:
            BadValue: not a class that this stream can have.
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
        """As `AsyncFeed.subscribe`; with `kind`, to packets of that class."""
        if kind is None:
            return await super().subscribe(callback, deadline=deadline, on_deadline=on_deadline)
        feed: AsyncFeed[Any] = self.of(kind)
        return await feed.subscribe(callback, deadline=deadline, on_deadline=on_deadline)

    async def description(self) -> dict[str, Any]:
        """As `Stream.description`."""
        return self.stream.description()

    async def join(self, timeout: float | None = None) -> bool:
        """Wait until the stream is over: closed, or given up; False when time is up. At once where nothing has started.

        Raises:
            BadValue: `timeout` is not a number of seconds.
        """
        return await self._loop_connection.joined(None if timeout is None else check_seconds(timeout, "timeout"))

    async def close(self) -> None:
        """Disconnect and end every iterator and subscription. Idempotent.

        What waits is dropped and counted; under the policy `block` it can still be taken.
        """
        await self._loop_connection.disconnected()

    async def __aenter__(self) -> AsyncStream[T]:
        return self

    async def __aexit__(self, *exc: object) -> None:
        await self.close()

    def __repr__(self) -> str:
        return f"<Async{repr(self.stream).removeprefix('<')}"

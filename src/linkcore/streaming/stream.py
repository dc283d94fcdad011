"""`Stream`: one interface of one peer, for users."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import Any, TypeVar

from ..arguments import check_seconds
from ..errors import BadValue
from ..wire.packet import State
from .connection import Connection
from .connection_life import ConnectionEvent, ConnectionState, Traffic
from .feed import Feed
from .packet_queue import Policy
from .statistics import StreamStatistics
from .subscription import Subscription

T = TypeVar("T")
K = TypeVar("K")


class Stream(Feed[T]):
    """The packets of one interface of one robot: iterate, subscribe, look at the newest, wait for the next.

    Connects when first used, connects again by itself when the connection is lost, and keeps its subscriptions
    meanwhile. Close it: one that is merely let go is closed with a `ResourceWarning`, or goes on where a callback still
    refers to it.
    """

    @property
    def name(self) -> str:
        """The address and the interface."""
        return self._connection.name

    @property
    def connection(self) -> ConnectionState:
        """What the connection is doing."""
        return self._connection.state

    @property
    def failure(self) -> Exception | None:
        """What ended the stream, where it was not closed on purpose."""
        return self._connection.failure

    @property
    def stats(self) -> StreamStatistics:
        """The counters at this moment."""
        return self._connection.counters.statistics

    def start(self) -> None:
        """Connect, if nothing has yet, and wait until it is done.

        Raises:
            RemoteError: the connection could not be made; the next use tries again.
            LocalError: the system has no thread left.
            Closed: the stream was closed.
        """
        self._connection.start()

    def description(self) -> dict[str, Any]:
        """What a recording has to say of this stream beyond its name so that its bytes can be read; JSON can hold it.

        Raises:
            RemoteError, LocalError, Closed: as `start`, where the peer has to be asked for it.
        """
        return {}

    def of(self, kind: type[K]) -> Feed[K]:
        """The packets of another class on the same stream.

        A class of packet, of a part of one, a base class of several, `ConnectionEvent`, or `Traffic` for the bytes as
        they came.

        Raises:
            BadValue: not a class that this stream can have.
        """
        if not (isinstance(kind, type) and issubclass(kind, (State, ConnectionEvent, Traffic))):
            raise BadValue(f"kind={kind!r}; expected a class of packets such as {self._kind.__name__}")
        fan_out = self._connection.fan_out
        if issubclass(kind, State) and not fan_out.carries(kind):
            there = ", ".join(each.__name__ for each in fan_out.kinds)
            raise BadValue(f"{self.name} never has a {kind.__name__}; what comes there is {there}")
        return Feed(self._connection, kind, lossless=self._lossless, owner=self)

    def subscribe(
        self,
        callback: Callable[[Any], object],
        kind: type | None = None,
        *,
        policy: Policy | None = None,
        lifespan: float | None = None,
        deadline: float | None = None,
        on_deadline: Callable[[float], object] | None = None,
        inline: bool = False,
    ) -> Subscription:
        """As `Feed.subscribe`; with `kind`, to packets of that class: ``of(kind).subscribe(...)``."""
        feed: Feed[Any] = self.of(self._kind if kind is None else kind)
        return feed.subscribe(
            callback, policy=policy, lifespan=lifespan, deadline=deadline, on_deadline=on_deadline, inline=inline
        )

    def join(self, timeout: float | None = None) -> bool:
        """Wait until a recording is over and all of it is delivered; False when time is up.

        Raises:
            BadValue: `timeout` is not a number of seconds.
        """
        return self._connection.join(float("inf") if timeout is None else check_seconds(timeout, "timeout"))

    def close(self, timeout: float = 2.0) -> None:
        """Disconnect and end every subscription and iteration; within `timeout` seconds.

        What waits is dropped and counted, but under the policy `block` it is still delivered, if need be after this has
        returned. A callback that is running then is left to end by itself. Only a reader that is still kept when time
        is up, by a full queue or an inline callback, makes `block` drop too. Idempotent; may be called from a callback.

        Raises:
            BadValue: `timeout` is not a number of seconds.
        """
        self._connection.close(check_seconds(timeout, "timeout"))

    def __del__(self) -> None:
        connection: Connection | None = getattr(self, "_connection", None)  # None: it was never made
        if connection is not None and connection.is_running and not connection.is_over:
            warnings.warn(f"{self!r} was not closed", ResourceWarning, source=self, stacklevel=2)
            connection.abandon()

    def _repr_html_(self) -> str:
        from ..text import html_table  # imported here: importing the library stays cheap

        stats = self.stats
        rows = [
            (name, getattr(stats, name))
            for name in ("received", "decoded", "failed", "dropped", "reconnects", "rate", "age")
        ]
        return html_table(repr(self), (), [(name, "" if value is None else f"{value:.6g}") for name, value in rows])

    def __repr__(self) -> str:
        stats = self.stats
        age = "nothing received" if stats.age is None else f"{stats.received} received, the last {stats.age:.3f} s ago"
        return (
            f"<Stream of {self._kind.__name__} from {self.name}: {self.connection.value}, {stats.rate:.0f} Hz, {age}>"
        )

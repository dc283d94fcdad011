"""Class `Stream`: the public interface to the packets of one interface of a peer."""

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
    """The packets of one interface of a robot: iterate, subscribe, read the newest, or wait for the next.

    A stream connects when it is first used. When the connection is lost, the stream reconnects automatically; its
    subscriptions continue. You should close a stream when you no longer need it. A stream that is garbage-collected
    without being closed is closed with a `ResourceWarning`, but a stream to which a callback still refers keeps
    running.
    """

    @property
    def name(self) -> str:
        """Address and interface."""
        return self._connection.name

    @property
    def connection(self) -> ConnectionState:
        """Current state of the connection."""
        return self._connection.state

    @property
    def failure(self) -> Exception | None:
        """Error that ended the stream; None if it was closed on purpose, or has not ended."""
        return self._connection.failure

    @property
    def stats(self) -> StreamStatistics:
        """Counters at this moment."""
        return self._connection.counters.statistics

    def start(self) -> None:
        """Connect if the stream has not connected yet, and wait until it is connected.

        Raises:
            RemoteError: If the connection cannot be made; the next use tries again.
            LocalError: If the system has no thread left.
            Closed: If the stream was closed.
        """
        self._connection.start()

    def description(self) -> dict[str, Any]:
        """Return the data that a recording needs in addition to the name to decode the bytes of this stream.

        JSON can represent the data.

        Raises:
            RemoteError, LocalError, Closed: If the peer must be asked for the data. See `start`.
        """
        return {}

    def of(self, kind: type[K]) -> Feed[K]:
        """Return the feed of another class of packets on the same stream.

        Args:
            kind: Class of packets or of parts of packets, a base class of several of them, `ConnectionEvent`, or
                `Traffic` for the received bytes.

        Raises:
            BadValue: If packets of this class cannot arrive on this stream.
        """
        if not (isinstance(kind, type) and issubclass(kind, (State, ConnectionEvent, Traffic))):
            raise BadValue(f"kind={kind!r}; expected a class of packets such as {self._kind.__name__}")
        fan_out = self._connection.fan_out
        if issubclass(kind, State) and not fan_out.carries(kind):
            there = ", ".join(each.__name__ for each in fan_out.kinds)
            raise BadValue(f"{self.name} has no packets of class {kind.__name__}; expected one of {there}")
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
        """Subscribe as with `Feed.subscribe`; with `kind`, to the packets of this class.

        ``subscribe(callback, kind)`` is the same as ``of(kind).subscribe(callback)``.
        """
        feed: Feed[Any] = self.of(self._kind if kind is None else kind)
        return feed.subscribe(
            callback, policy=policy, lifespan=lifespan, deadline=deadline, on_deadline=on_deadline, inline=inline
        )

    def join(self, timeout: float | None = None) -> bool:
        """Wait until a recording has ended and all of it is delivered.

        Return False after `timeout` seconds.

        Args:
            timeout: Maximum wait in seconds; None for no limit.

        Raises:
            BadValue: If `timeout` is not a number of seconds.
        """
        return self._connection.join(float("inf") if timeout is None else check_seconds(timeout, "timeout"))

    def close(self, timeout: float = 2.0) -> None:
        """Disconnect and end every subscription and iteration, within `timeout` seconds.

        Queued packets are dropped and counted. Under the policy `block` they are still delivered, if necessary after
        this has returned. A callback that still runs after `timeout` is left to end on its own. If a full queue or an
        inline callback still blocks the reader after `timeout`, the policy `block` drops its packets too. Idempotent;
        may be called from a callback.

        Raises:
            BadValue: If `timeout` is not a number of seconds.
        """
        self._connection.close(check_seconds(timeout, "timeout"))

    def __del__(self) -> None:
        connection: Connection | None = getattr(self, "_connection", None)  # None if `__init__` has failed
        if connection is not None and connection.is_running and not connection.is_over:
            warnings.warn(f"{self!r} was not closed", ResourceWarning, source=self, stacklevel=2)
            connection.abandon()

    def _repr_html_(self) -> str:
        from ..text import html_table  # imported here: importing the library stays fast

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

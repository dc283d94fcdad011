"""The packets of one class on a stream, as users hold them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from ..errors import BadValue
from .policy import Policy, drop_oldest, latest
from .subscription import Subscription

if TYPE_CHECKING:
    from .stream import Stream

__all__ = ["Feed"]

T = TypeVar("T")


class Feed(Generic[T]):
    """The packets of one class on a stream: iterate, subscribe, look at the newest, wait for the next."""

    def __init__(self, stream: Stream[Any], kind: type[T]) -> None:
        self._stream = stream
        self._kind = kind

    @property
    def latest(self) -> T | None:
        """The newest packet of this connection, or None. Never blocks.

        None before the first packet came and again as soon as the connection is lost: old data is
        never shown as new. A recording that is over keeps its last one. Begins to connect, if
        nothing has yet.
        """
        self._stream.start_quietly()
        newest: T | None = self._stream.newest(self._kind)
        return newest

    def wait(self, timeout: float = 5.0) -> T:
        """The next packet that arrives.

        Raises:
            LinkTimeout: none came within `timeout` seconds.
            RemoteError: the first connection could not be made, or the stream gave up.
            Closed: the stream was closed.
        """
        inbox = self._stream.open_inbox(self._kind, latest, counts=False)
        try:
            packet = inbox.next(timeout)
            if packet is not None:
                first: T = next(iter(self._stream.expand(self._kind, packet)))
                return first
        finally:
            self._stream.close_inbox(inbox)
        raise self._stream.why_nothing(self._kind, timeout)

    def iterate(self, policy: Policy | None = None, timeout: float | None = None) -> Iterator[T]:
        """Iterate with a policy or a timeout of your own; a plain ``for`` keeps the newest state, or 1024 events.

        Ends when the stream is closed, or a recording is over. Without a timeout it waits for as
        long as the backoff allows for a robot that went away; `ConnectionEvent` tells of that.

        Raises:
            LinkTimeout: nothing came within `timeout` seconds.
            RemoteError: the first connection could not be made, or the stream gave up.
        """
        stream = self._stream
        inbox = stream.open_inbox(self._kind, policy or stream.default_policy(self._kind, latest))
        try:
            while True:
                packet = inbox.next(timeout)
                if packet is not None:
                    yield from stream.expand(self._kind, packet)
                elif inbox.is_over:
                    break
                elif timeout is not None:
                    raise stream.why_nothing(self._kind, timeout)
        finally:
            stream.close_inbox(inbox)
        if stream.failure is not None:
            raise stream.failure

    def __iter__(self) -> Iterator[T]:
        return self.iterate()

    def subscribe(
        self,
        callback: Callable[[T], object],
        *,
        policy: Policy | None = None,
        deadline: float | None = None,
        on_deadline: Callable[[float], object] | None = None,
    ) -> Subscription:
        """Call `callback` with each packet, in order and one at a time, until closed.

        In a thread of its own, or, once it has proved quick, in the thread that reads the stream: so
        the thread may change, and a callback that hangs after having been quick can keep the other
        subscribers waiting for up to 100 ms.

        Args:
            callback: may be slow and may raise; no packet of anybody else's is lost by that.
            policy: what to do when it falls behind: `latest`, `drop_oldest(n)` or `block`; by
                default `drop_oldest(256)`, and 1024 for events.
            deadline: seconds within which a packet has to come.
            on_deadline: called with the seconds since the last packet, once for each silence that
                lasts longer than `deadline`; by default the log gets a warning.

        Raises:
            RemoteError: the first connection could not be made.
            Closed: the stream was closed.
        """
        if deadline is not None and not deadline > 0:
            raise BadValue(f"deadline is {deadline}; expected a positive number of seconds")
        if on_deadline is not None and deadline is None:
            raise BadValue("on_deadline was given without a deadline")
        return self._stream.open_subscription(
            self._kind,
            callback,
            policy=policy or self._stream.default_policy(self._kind, drop_oldest(256)),
            deadline=deadline,
            on_deadline=on_deadline,
        )

"""Second, independent count of packets, which is compared with the counters of streams and subscriptions."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

from linkcore.streaming.connection import Connection
from linkcore.streaming.connection_life import ConnectionState
from linkcore.streaming.fanout import FanOut
from linkcore.streaming.subscription import Subscription
from urlink.protocol.realtime.packets import RealtimeState

from .observed import replaced

__all__ = ["Counted"]


@dataclass(eq=False)
class _Stream:
    """Observations of one stream.

    Attributes:
        begun, done: Numbers of packets before and after their publication.
        connections: Number of connections.
        missed: Number of missing cycles between states of one connection.
        last: Time of the last state of this connection on the controller's clock, in s.
        is_known: Whether two consecutive states of this connection have shown the duration of a cycle.
        is_vague: Whether cycles were missing before that, so that the library assumes the longest possible cycle.
    """

    begun: int = 0
    done: int = 0
    connections: int = 0
    missed: int = 0
    last: float | None = None
    is_known: bool = False
    is_vague: bool = False


class Counted:
    """Counter of the packets of every stream in a world.

    Args:
        rate: Cycles of the controller per second.
        fault: Function that reports a fault.
    """

    def __init__(self, rate: int, fault: Callable[[str], object]) -> None:
        self._rate = rate
        self._fault = fault
        self._streams: dict[FanOut, _Stream] = {}
        #: For each subscriber to whole packets: packets published before it was added, and packets begun afterwards.
        self._since: dict[object, tuple[int, int]] = {}
        #: Number of calls of the callback of each subscription.
        self._calls: dict[Subscription, list[int]] = {}

    @contextlib.contextmanager
    def watching(self) -> Iterator[None]:
        """Count packets while the block lasts."""
        with (
            replaced(FanOut, "publish", self._publish),
            replaced(FanOut, "add", self._add),
            replaced(FanOut, "remove", self._remove),
            replaced(Connection, "_tell", self._tell),
            replaced(Connection, "subscribe", self._subscribe),
            replaced(Subscription, "close", self._close),
        ):
            yield

    def _of(self, fan_out: FanOut) -> _Stream:
        return self._streams.setdefault(fan_out, _Stream())

    def _publish(self, publish: Callable[..., None]) -> Callable[..., None]:
        def wrapped(fan_out: FanOut, packets: Any, is_steady: bool = False) -> None:
            stream = self._of(fan_out)
            stream.begun += len(packets)
            for state in packets:
                if type(state) is RealtimeState:
                    cycles = 1 if stream.last is None else round((state.time - stream.last) * self._rate)
                    stream.missed += max(cycles - 1, 0)
                    stream.is_known |= stream.last is not None and cycles == 1
                    stream.is_vague |= cycles > 1 and not stream.is_known
                    stream.last = state.time
            publish(fan_out, packets, is_steady)
            stream.done += len(packets)

        return wrapped

    def _add(self, add: Callable[..., None]) -> Callable[..., None]:
        def wrapped(fan_out: FanOut, sink: Any, kind: type) -> None:
            stream = self._of(fan_out)
            done = stream.done
            add(fan_out, sink, kind)
            if kind is RealtimeState:
                self._since[sink] = done, stream.begun

        return wrapped

    def _remove(self, remove: Callable[..., None]) -> Callable[..., None]:
        def wrapped(fan_out: FanOut, sink: Any) -> None:
            stream = self._of(fan_out)
            is_over = getattr(sink, "_is_ended", False) or getattr(sink, "_is_closed", False)
            done = stream.done
            remove(fan_out, sink)
            since = self._since.pop(sink, None)
            if since is None:
                return
            least, most = (0 if is_over else done - since[1]), stream.begun - since[0]
            if not least <= sink.offered <= most:
                self._fault(f"a subscriber counts {sink.offered} packets, but {least} to {most} were offered to it")

        return wrapped

    def _tell(self, tell: Callable[..., None]) -> Callable[..., None]:
        def wrapped(connection: Connection, state: ConnectionState, error: Exception | None = None) -> None:
            stream = self._of(connection.fan_out)
            if state is ConnectionState.CONNECTED:
                stream.connections += 1
                stream.last, stream.is_known = None, False
            elif state in (ConnectionState.CLOSED, ConnectionState.IDLE):
                self._check(connection, stream)
            tell(connection, state, error)

        return wrapped

    def _check(self, connection: Connection, stream: _Stream) -> None:
        stats, name = connection.counters.statistics, connection.name
        if stats.received != stats.decoded + stats.failed:
            self._fault(f"{name}: {stats.received} received, {stats.decoded} decoded and {stats.failed} failed")
        if stats.decoded != stream.done:
            self._fault(f"{name} counts {stats.decoded} packets, but {stream.done} were published")
        if stats.reconnects != max(stream.connections - 1, 0):
            self._fault(f"{name} counts {stats.reconnects} reconnects, but was connected {stream.connections} times")
        if (
            stream.last is not None
            and not (stats.failed or stream.is_vague)
            and stats.missed not in (None, stream.missed)
        ):
            self._fault(f"{name} counts {stats.missed} missed cycles, but the controller's clock shows {stream.missed}")

    def _subscribe(self, subscribe: Callable[..., Subscription]) -> Callable[..., Subscription]:
        def wrapped(connection: Connection, kind: type, callback: Callable[[Any], object], **how: Any) -> Subscription:
            calls = [0]

            def counted(packet: Any) -> object:
                calls[0] += 1
                return callback(packet)

            subscription = subscribe(connection, kind, counted, **how)
            if kind is RealtimeState:
                self._calls[subscription] = calls
            return subscription

        return wrapped

    def _close(self, close: Callable[..., None]) -> Callable[..., None]:
        def wrapped(subscription: Subscription, timeout: float = 1.0) -> None:
            close(subscription, timeout)
            stats, calls = subscription.stats, self._calls.pop(subscription, None)
            taken = stats.delivered + stats.dropped + stats.raised + stats.waiting
            if timeout and stats.offered != taken:
                self._fault(f"{subscription.name}: {stats.offered} packets offered, but {taken} accounted for: {stats}")
            handed = stats.delivered + stats.raised
            # A waiting packet may be in the callback, or come from a reader that was in the middle of an offer.
            if timeout and calls is not None and not handed <= calls[0] <= handed + stats.waiting:
                self._fault(f"{subscription.name}: the callback was called {calls[0]} times: {stats}")

        return wrapped

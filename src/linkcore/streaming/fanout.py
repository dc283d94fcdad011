"""Distributes every packet of a stream to each queue and each inline callback that subscribed to its class.

Called by the thread that reads, which meets no lock here: tuples are replaced and never changed.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple, Protocol, TypeVar

from ..clock import Stamp
from .connection_life import Chunk, ConnectionEvent, Traffic
from .subscription import Delivery

#: A NamedTuple made without its own `__new__`, which is a call of Python code for each packet.
_new = tuple.__new__

K = TypeVar("K")
_Offer = Callable[[Sequence[Any]], None]


class Sink(Protocol):
    """What packets are offered to."""

    #: is served after the others, since it calls back at once
    is_inline: bool
    #: the reader waits for it, so that every packet is delivered
    makes_reader_wait: bool

    @property
    def offered(self) -> int:
        """Packets that came here."""

    def offer(self, packets: Sequence[Any]) -> None:
        """Take packets."""

    def end(self) -> None:
        """No more will come; what waits is still delivered."""

    def close(self) -> None:
        """No more will come, and what waits is dropped."""


class _Route(NamedTuple):
    sink: Sink
    group: type
    offer: _Offer


class FanOut:
    """The subscribers of one stream, and the newest packet of each class.

    Args:
        kind: the main class of packet.
        parts: the packets inside a packet; None if there are none.
        others: base classes of what else comes, parts included.
        ahead: returns the newest packet where it is known before it is published (`linkcore.net.isolated_transport`);
            None if there is none. For a stream without parts.

    Attributes:
        kinds: classes of packet and of part that can come, the main one first.
        taps: subscribers to the bytes as they were received.
    """

    def __init__(
        self,
        kind: type,
        *,
        parts: Callable[[Any], Iterable[Any]] | None = None,
        others: Iterable[type] = (),
        ahead: Callable[[], Any | None] | None = None,
    ) -> None:
        self.kinds = (kind, *others)
        self._kind = kind
        self._parts = parts
        self._ahead = ahead
        # Re-entrant: a stream that is collected in the middle of a change ends its fan-out from here.
        self._lock = threading.RLock()
        # Dictionaries, of which one step adds or removes an entry: a signal handler that subscribes or closes in the
        # middle of a change of its own thread is neither undone by it nor lost. In the order of subscribing.
        self._routes: dict[_Route, None] = {}
        self._deliveries: dict[Delivery, None] = {}
        # What the reader looks at, made from the routes: all, those of the queues, and those of the inline callbacks.
        self._offers: tuple[tuple[_Offer, ...], tuple[_Offer, ...], tuple[_Offer, ...]] = ((), (), ())
        self.taps: tuple[Sink, ...] = ()
        self._last: Any = None  # where no packet has parts, which is the quick case
        self._newest: dict[type, tuple[int, Any]] = {}
        self._number = 0

    # -- what the reader hands out -------------------------------------------------------------

    def tap(self, data: bytes, rest: bytes, stamp: Stamp) -> None:
        """Bytes as they came; `rest` is the head of the packet they came into."""
        for sink in self.taps:
            if rest and not sink.offered:
                sink.offer((Chunk(rest, stamp),))
            sink.offer((_new(Chunk, (data, stamp)),))

    def publish(self, packets: Sequence[Any]) -> None:
        """Packets, in order, at least one.

        Each goes to all inline callbacks before the next one does: one of them may decide by what another one has
        learnt, such as whether a program may go on that has begun after a stop, all in the same bytes.
        """
        if self._parts is None:
            self._last = packets[-1]
        else:
            for packet in packets:
                self._remember(packet)
                for part in self._parts(packet):
                    self._remember(part)
        every, queues, callbacks = self._offers
        if len(packets) == 1 or len(callbacks) < 2:
            for offer in every:
                offer(packets)
            return
        for offer in queues:
            offer(packets)
        for packet in packets:
            for offer in callbacks:
                offer((packet,))

    def tell(self, event: ConnectionEvent) -> None:
        """A change of the connection."""
        for route in self._now():
            if route.group is not object:
                route.offer((event,))

    def forget(self) -> None:
        """What was newest is so no longer."""
        self._newest = {}
        self._last = None

    def end(self) -> None:
        """No more will come; what waits is still delivered."""
        with self._lock:
            routes = self._now()
            for route in routes:
                self._routes.pop(route, None)
            self._update()
        for route in routes:
            route.sink.end()

    def _remember(self, packet: Any) -> None:
        self._number += 1
        self._newest[type(packet)] = (self._number, packet)

    # -- what feeds ask for --------------------------------------------------------------------

    def carries(self, kind: type) -> bool:
        """Whether a `kind` can ever come: it is a class of packet or part, a subclass or a base class of one."""
        return any(issubclass(kind, each) or issubclass(each, kind) for each in self.kinds)

    def newest(self, kind: type[K]) -> K | None:
        """The newest packet of class `kind`."""
        if self._parts is None:
            last = self._last if self._ahead is None else self._ahead()
            return last if isinstance(last, kind) else None
        exact = self._newest.get(kind)
        if exact is not None:
            found: K = exact[1]
            return found
        candidates = [each for each in list(self._newest.values()) if isinstance(each[1], kind)]
        return max(candidates, key=lambda each: each[0])[1] if candidates else None

    def expand(self, kind: type[K], packet: Any) -> Iterable[K]:
        """What of class `kind` a packet is or holds."""
        if isinstance(packet, kind):
            return (packet,)
        return [part for part in self._parts(packet) if isinstance(part, kind)] if self._parts is not None else ()

    def expander(self, kind: type) -> Callable[[Any], Iterable[Any]] | None:
        """What `expand` does for one class; None where a packet always is what was asked for."""
        if kind in (self._kind, ConnectionEvent, Traffic):
            return None
        return lambda packet: self.expand(kind, packet)

    def add(self, sink: Sink, kind: type) -> None:
        """Offer to `sink` each packet that is or holds a `kind`."""
        group: type = object
        offer: _Offer = sink.offer
        if kind in (Traffic, ConnectionEvent):
            group = kind
        elif kind is not self._kind or self._parts is not None:
            offer = self._filtered(kind, sink)
        with self._lock:
            self._routes[_Route(sink, group, offer)] = None
            self._update()

    def _filtered(self, kind: type, sink: Sink) -> _Offer:
        expand = self.expand

        def offer(packets: Sequence[Any]) -> None:
            wanted = [packet for packet in packets if any(True for _ in expand(kind, packet))]
            if wanted:
                sink.offer(wanted)

        return offer

    def remove(self, sink: Sink) -> None:
        """Offer to `sink` no more; what waits in it can still be taken."""
        with self._lock:
            for route in self._now():
                if route.sink is sink:
                    self._routes.pop(route, None)
            self._update()

    def _now(self) -> list[_Route]:
        # Inline callbacks come last: one that is slow then keeps no queue waiting.
        return sorted(self._routes, key=lambda route: route.sink.is_inline)

    def _update(self) -> None:
        """Make what the reader looks at from the routes; again if a signal handler changes them meanwhile."""
        routes: list[_Route] | None = None
        while routes != (routes := self._now()):
            offered = [route for route in routes if route.group is object]
            queues, callbacks = (
                tuple(route.offer for route in offered if route.sink.is_inline is is_inline)
                for is_inline in (False, True)
            )
            self._offers = (queues + callbacks, queues, callbacks)
            self.taps = tuple(route.sink for route in routes if route.group is Traffic)

    # -- callbacks -------------------------------------------------------------------------------

    @property
    def deliveries(self) -> tuple[Delivery, ...]:
        """The callbacks."""
        return tuple(self._deliveries)

    def add_delivery(self, delivery: Delivery) -> None:
        """Remember a callback, so that closing the stream can wait for it."""
        with self._lock:
            self._deliveries[delivery] = None

    def remove_delivery(self, delivery: Delivery) -> None:
        """Offer to a callback no more, and forget it."""
        with self._lock:
            self.remove(delivery.sink)
            self._deliveries.pop(delivery, None)

    def close(self, *, all: bool) -> None:
        """Close what promised nothing, or the callers wait in themselves; or all of it."""
        callers = [delivery.sink for delivery in self.deliveries if delivery.runs_here()]
        for route in self._now():
            if all or not route.sink.makes_reader_wait or route.sink in callers:
                route.sink.close()

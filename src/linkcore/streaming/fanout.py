"""Distribution of the packets of a stream to each queue and each inline callback that subscribed to their class.

The thread that reads the stream publishes the packets. It needs no lock, because tuples are replaced and never changed.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple, Protocol, TypeVar

from ..clock import Stamp
from ..deferred import Unread
from .connection_life import Chunk, ConnectionEvent, Traffic
from .subscription import Delivery, InlineDelivery

#: Makes a NamedTuple without its own `__new__`, which would be a call of Python code for each packet.
_new = tuple.__new__

K = TypeVar("K")
_Offer = Callable[[Sequence[Any]], None]


class Sink(Protocol):
    """Receiver of offered packets: a queue, or an inline callback."""

    #: Whether it calls its callback at once. Such sinks get their packets after the other sinks.
    is_inline: bool
    #: Whether the reader waits for it, so that every packet is delivered.
    makes_reader_wait: bool

    @property
    def offered(self) -> int:
        """Number of packets that were offered."""

    def offer(self, packets: Sequence[Any]) -> None:
        """Accept packets."""

    def offer_steady(self, packets: Sequence[Any]) -> None:
        """Accept steady packets; see `FanOut.publish`."""

    def end(self) -> None:
        """Accept no more packets; queued packets are still delivered."""

    def close(self) -> None:
        """Accept no more packets, and drop queued packets."""


class _Route(NamedTuple):
    sink: Sink
    group: type
    offer: _Offer
    offer_steady: _Offer


class FanOut:
    """Subscribers of one stream, and the newest packet of each class.

    Args:
        kind: Main class of packets.
        parts: Function that returns the packets inside a packet; None if packets have no parts.
        others: Base classes of all other packets that can arrive, parts included.
        ahead: Function that returns the newest packet even before it is published (`linkcore.net.isolated_transport`).
            None if there is no such function. Only for a stream without parts.

    Attributes:
        kinds: Classes of packets and parts that can arrive, with the main class first.
        taps: Subscribers to the received bytes.
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
        # Re-entrant: if a stream is garbage-collected in the middle of a change, it ends its fan-out in this thread.
        self._lock = threading.RLock()
        # A dictionary adds or removes an entry in one step. So if a signal handler subscribes or closes in the middle
        # of a change, the interrupted code does not undo or lose its change. Entries are in the order of subscribing.
        self._routes: dict[_Route, None] = {}
        self._deliveries: dict[Delivery, None] = {}
        # The reader uses these tuples, which are made from the routes: all sinks, the queues, the inline callbacks.
        self._offers: tuple[tuple[_Offer, ...], tuple[_Offer, ...], tuple[_Offer, ...]] = ((), (), ())
        # For steady packets: the same sinks, those that are inline callbacks, whether there are others, and whether one
        # of those makes the reader wait.
        self._steady: tuple[_Offer, ...] = ()
        self._inline: tuple[InlineDelivery, ...] = ()
        self._has_queues = self._makes_reader_wait = False
        self.taps: tuple[Sink, ...] = ()
        self._last: Any = None  # the newest packet, only for streams whose packets have no parts
        self._newest: dict[type, tuple[int, Any]] = {}
        # Newest packet of a simulated peer, until somebody asks for its parts.
        self._unread: Unread | None = None
        self._number = 0

    # -- called by the reader ------------------------------------------------------------------

    def tap(self, data: bytes, rest: bytes, stamp: Stamp) -> None:
        """Publish received bytes; `rest` holds the earlier bytes of the packet that they continue."""
        for sink in self.taps:
            if rest and not sink.offered:
                sink.offer((Chunk(rest, stamp),))
            sink.offer((_new(Chunk, (bytes(data), stamp)),))

    def publish(self, packets: Sequence[Any], is_steady: bool = False) -> None:
        """Publish one or more packets, in order.

        Args:
            packets: Packets.
            is_steady: Whether the packets are steady, and `takes_at_once` has just returned True. If the packets are
                `Unread`, `takes_batches` has returned True.

        Each packet goes to all inline callbacks before the next packet does, because one callback might depend on the
        result of another one. For example, a stop and the start of a program might arrive in the same bytes, and a
        callback then decides whether this program may continue.
        """
        if self._parts is None:
            self._last = packets[-1]
        elif is_steady and isinstance(packets[-1], Unread):
            self._unread = packets[-1]
        else:
            self._read()
            self._remember_all(packets)
        if is_steady:
            for offer in self._steady:
                offer(packets)
            return
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

    def takes_batches(self) -> bool:
        """Whether no sink needs each of several steady packets at the time of its arrival."""
        return not (self._has_queues or self.taps) and self._needs_only_changes()

    def takes_at_once(self) -> bool:
        """Whether no sink makes the reader wait, or calls a function of the user, for a steady packet."""
        return not (self._makes_reader_wait or self.taps) and self._needs_only_changes()

    def _needs_only_changes(self) -> bool:
        """Whether no inline callback currently needs steady packets."""
        for sink in self._inline:  # noqa: SIM110 -- this is called for each packet, and `all` would take twice as long
            if not sink.only_changes():
                return False
        return True

    def tell(self, event: ConnectionEvent) -> None:
        """Publish a change of the connection."""
        for route in self._now():
            if route.group is not object:
                route.offer((event,))

    def forget(self) -> None:
        """Forget the newest packets."""
        self._newest = {}
        self._last = self._unread = None

    def end(self) -> None:
        """End all sinks: no more packets will arrive, but queued packets are still delivered."""
        with self._lock:
            routes = self._now()
            for route in routes:
                self._routes.pop(route, None)
            self._update()
        for route in routes:
            route.sink.end()

    def _read(self) -> None:
        """Make the newest packet of a simulated peer, with its parts, if it was not made yet."""
        unread, self._unread = self._unread, None
        if unread is not None:
            self._remember_all([unread.read()])

    def _remember_all(self, packets: Sequence[Any]) -> None:
        assert self._parts is not None, "the packets have no parts"
        for packet in packets:
            self._remember(packet)
            for part in self._parts(packet):
                self._remember(part)

    def _remember(self, packet: Any) -> None:
        self._number += 1
        self._newest[type(packet)] = (self._number, packet)

    # -- called by feeds -----------------------------------------------------------------------

    def carries(self, kind: type) -> bool:
        """Whether a `kind` can arrive: it is a class of packets or parts, or a subclass or base class of one."""
        return any(issubclass(kind, each) or issubclass(each, kind) for each in self.kinds)

    def newest(self, kind: type[K]) -> K | None:
        """Return the newest packet of class `kind`, or None."""
        if self._parts is None:
            last = self._last if self._ahead is None else self._ahead()
            return last if isinstance(last, kind) else None
        self._read()
        exact = self._newest.get(kind)
        if exact is not None:
            found: K = exact[1]
            return found
        candidates = [each for each in list(self._newest.values()) if isinstance(each[1], kind)]
        return max(candidates, key=lambda each: each[0])[1] if candidates else None

    def expand(self, kind: type[K], packet: Any) -> Iterable[K]:
        """Return the packet itself if it is a `kind`, or else its parts that are a `kind`."""
        if isinstance(packet, kind):
            return (packet,)
        return [part for part in self._parts(packet) if isinstance(part, kind)] if self._parts is not None else ()

    def expander(self, kind: type) -> Callable[[Any], Iterable[Any]] | None:
        """Return `expand` for one class; None if every packet is of that class."""
        if kind in (self._kind, ConnectionEvent, Traffic):
            return None
        return lambda packet: self.expand(kind, packet)

    def add(self, sink: Sink, kind: type) -> None:
        """Start to offer to `sink` each packet that is or contains a `kind`."""
        group: type = object
        offer: _Offer = sink.offer
        offer_steady: _Offer = sink.offer_steady
        if kind in (Traffic, ConnectionEvent):
            group = kind
        elif kind is not self._kind or self._parts is not None:
            offer = self._filtered(kind, sink)
            if not sink.is_inline:  # an inline callback needs no steady packets, and an unread one has no class yet
                offer_steady = offer
        with self._lock:
            self._routes[_Route(sink, group, offer, offer_steady)] = None
            self._update()

    def _filtered(self, kind: type, sink: Sink) -> _Offer:
        expand = self.expand

        def offer(packets: Sequence[Any]) -> None:
            wanted = [packet for packet in packets if any(True for _ in expand(kind, packet))]
            if wanted:
                sink.offer(wanted)

        return offer

    def remove(self, sink: Sink) -> None:
        """Stop offering packets to `sink`; queued packets can still be taken."""
        with self._lock:
            for route in list(self._routes):
                if route.sink is sink:
                    self._routes.pop(route, None)
            self._update()

    @property
    def sinks(self) -> tuple[Sink, ...]:
        """Sinks that are offered packets, in the order in which they get them."""
        return tuple(route.sink for route in self._now())

    def _now(self) -> list[_Route]:
        # Copied in one step, because the reader calls this while other threads subscribe.
        routes = list(self._routes)
        # Inline callbacks come last, so that a slow one does not delay the queues.
        routes.sort(key=lambda route: route.sink.is_inline)
        return routes

    def _update(self) -> None:
        """Make the tuples of the reader from the routes.

        Repeat it if a signal handler changes the routes meanwhile.
        """
        known: list[_Route] | None = None
        while known != (known := list(self._routes)):
            offered = [route for route in known if route.group is object]
            first = [route for route in offered if not route.sink.is_inline]
            last = [route for route in offered if route.sink.is_inline]
            queues, callbacks = tuple([route.offer for route in first]), tuple([route.offer for route in last])
            self._offers = (queues + callbacks, queues, callbacks)
            self._inline = tuple([sink for sink in (route.sink for route in last) if isinstance(sink, InlineDelivery)])
            self._has_queues = bool(first)
            self._makes_reader_wait = any(route.sink.makes_reader_wait for route in first)
            self._steady = tuple([route.offer_steady for route in first + last])
            self.taps = tuple([route.sink for route in known if route.group is Traffic])

    # -- callbacks -------------------------------------------------------------------------------

    @property
    def deliveries(self) -> list[Delivery]:
        """Deliveries of all callbacks."""
        return list(self._deliveries)

    def add_delivery(self, delivery: Delivery) -> None:
        """Register a callback, so that closing the stream can wait for it."""
        with self._lock:
            self._deliveries[delivery] = None

    def remove_delivery(self, delivery: Delivery) -> None:
        """Stop offering packets to a callback, and forget it."""
        with self._lock:
            self.remove(delivery.sink)
            self._deliveries.pop(delivery, None)

    def close(self, *, all: bool) -> None:
        """Close all sinks; without `all`, close sinks that may lose packets and the sink whose callback calls this."""
        callers = [delivery.sink for delivery in self.deliveries if delivery.runs_here()]
        for sink in self.sinks:
            if all or not sink.makes_reader_wait or sink in callers:
                sink.close()

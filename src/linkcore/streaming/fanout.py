"""Who gets what: the subscribers of a stream, seen from the reader.

Packets go to inboxes, and last of all to the one subscription that the reader calls back itself.
Tuples are replaced, never changed, so that the reader needs no lock to walk them.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable, Sequence
from typing import Any, TypeVar

from ..stamp import Stamp
from .events import Chunk, ConnectionEvent, Traffic
from .packet_queue import Inbox
from .policy import Policy
from .shortcut import Shortcut
from .subscription import Subscription

__all__ = ["Distribution"]

# A NamedTuple made without its own __new__, which is written in Python.
_new = tuple.__new__

K = TypeVar("K")


class Distribution:
    """The inboxes and subscriptions of one stream, and the newest packet of each class.

    Args:
        kind: the main class of packet.
        parts: the packets inside a packet; None if there are none.
        read_on: becomes the reader in place of one that a callback keeps.

    Attributes:
        dropped: packets that at least one subscription dropped.
        taps: who gets everything as it came.
    """

    def __init__(self, kind: type, parts: Callable[[Any], Iterable[Any]] | None, read_on: Callable[[], object]) -> None:
        self.dropped = 0
        self._kind = kind
        self._parts = parts
        self._read_on = read_on
        self._lock = threading.Lock()
        self._is_open = True
        # Who gets packets (object), connection events, and everything as it came.
        self._inboxes: dict[type, tuple[Inbox, ...]] = {object: (), ConnectionEvent: (), Traffic: ()}
        self._subscriptions: tuple[Subscription, ...] = ()
        self._shortcut: Shortcut | None = None
        self._outlets: tuple[Inbox | Shortcut, ...] = ()
        self.taps: tuple[Inbox, ...] = ()
        self._newest: dict[type, Any] = {}

    # -- what the reader hands out -------------------------------------------------------------

    def tap(self, data: bytes, rest: bytes, stamp: Stamp) -> None:
        """Bytes as they came; `rest` is the head of the packet they came into."""
        for inbox in self.taps:
            if rest and not inbox.received:
                inbox.put(Chunk(rest, stamp))
            inbox.put(_new(Chunk, (data, stamp)))

    def publish(self, packets: Sequence[Any]) -> None:
        """Packets, in order.

        Raises:
            Relieved: a callback took so long that another thread has become the reader.
        """
        if self._parts is None:
            self._newest[self._kind] = packets[-1]
        else:
            for packet in packets:
                self._remember(packet)
                for part in self._parts(packet):
                    self._remember(part)
        for outlet in self._outlets:
            outlet.offer(packets)

    def tell(self, event: ConnectionEvent) -> None:
        """A change of the connection."""
        for group in (ConnectionEvent, Traffic):
            for inbox in self._inboxes[group]:
                inbox.offer((event,))

    def forget(self) -> None:
        """What was newest is so no longer."""
        self._newest = {}

    def end(self) -> None:
        """No more will come; what waits is still delivered."""
        with self._lock:
            self._end_shortcut()
            inboxes = self._all()
        for inbox in inboxes:
            inbox.end()

    def _remember(self, packet: Any) -> None:
        # Taken out first, so that the newest stands last.
        self._newest.pop(type(packet), None)
        self._newest[type(packet)] = packet

    # -- what feeds ask for --------------------------------------------------------------------

    def newest(self, kind: type[K]) -> K | None:
        """The newest packet of class `kind`."""
        newest = self._newest
        if kind in newest:
            exact: K = newest[kind]
            return exact
        for packet in reversed(list(newest.values())):
            if isinstance(packet, kind):
                return packet
        return None

    def expand(self, kind: type[K], packet: Any) -> Iterable[K]:
        """What of class `kind` a packet is or holds."""
        if isinstance(packet, kind):
            return (packet,)
        return [part for part in self._parts(packet) if isinstance(part, kind)] if self._parts is not None else ()

    def add_inbox(self, kind: type, policy: Policy, counts: bool) -> Inbox:
        """A queue of packets that are or hold a `kind`; without `counts`, nobody misses what it drops."""
        wants: Callable[[Any], bool] | None = None
        lost: Callable[[Any], None] | None = self._lose if counts else None
        group: type = object
        if kind in (Traffic, ConnectionEvent):
            group, lost = kind, None
        elif kind is not self._kind or self._parts is not None:
            expand = self.expand

            def wants(packet: Any) -> bool:
                return any(True for _ in expand(kind, packet))

        inbox = Inbox(policy, wants, lost)
        with self._lock:
            self._inboxes[group] = (*self._inboxes[group], inbox)
            self._route()
        return inbox

    def remove_inbox(self, inbox: Inbox) -> None:
        """Give a queue no more; what waits in it can still be taken."""
        with self._lock:
            for group, inboxes in list(self._inboxes.items()):
                self._inboxes[group] = tuple(each for each in inboxes if each is not inbox)
            if self._shortcut is not None and self._shortcut.inbox is inbox:
                self._end_shortcut()
            self._route()

    def add_subscription(
        self,
        name: str,
        kind: type,
        callback: Callable[[Any], object],
        inbox: Inbox,
        deadline: float | None,
        on_deadline: Callable[[float], object] | None,
        linger: float,
    ) -> Subscription:
        """A callback on `inbox`."""
        whole = kind is self._kind or kind in (Traffic, ConnectionEvent)
        subscription = Subscription(
            inbox,
            callback,
            name=name,
            detach=self._remove_subscription,
            trust=self._trust if kind is self._kind and self._parts is None else None,
            expand=None if whole else lambda packet: self.expand(kind, packet),
            deadline=deadline,
            on_deadline=on_deadline,
            linger=linger,
        )
        with self._lock:
            self._subscriptions = (*self._subscriptions, subscription)
        return subscription

    def _remove_subscription(self, subscription: Subscription) -> None:
        self.remove_inbox(subscription.inbox)
        with self._lock:
            self._subscriptions = tuple(each for each in self._subscriptions if each is not subscription)

    # -- what the stream asks for when it closes -------------------------------------------------

    @property
    def subscriptions(self) -> tuple[Subscription, ...]:
        """The callbacks."""
        return self._subscriptions

    def close_evicting(self) -> None:
        """Drop what waits where nothing was promised, or where the caller keeps it from being taken."""
        with self._lock:
            self._is_open = False
            self._end_shortcut()
            inboxes = self._all()
        here = threading.get_ident()
        callers = [each.inbox for each in self._subscriptions if each.runs_in(here)]
        for inbox in inboxes:
            if inbox.evicts or inbox in callers:
                inbox.close()

    def close_all(self) -> None:
        """Drop whatever waits."""
        with self._lock:
            inboxes = self._all()
        for inbox in inboxes:
            inbox.close()

    def _all(self) -> list[Inbox]:
        return [inbox for group in self._inboxes.values() for inbox in group]

    # -- the short way ---------------------------------------------------------------------------

    def _route(self) -> None:
        """Say anew where packets go; with the lock."""
        self.taps = self._inboxes[Traffic]
        inboxes, shortcut = self._inboxes[object], self._shortcut
        if shortcut is None:
            self._outlets = inboxes
        else:
            self._outlets = (*(inbox for inbox in inboxes if inbox is not shortcut.inbox), shortcut)

    def _trust(self, subscription: Subscription) -> None:
        """Let the reader call this subscription back itself, if it does so for no other."""
        with self._lock:
            is_here = any(inbox is subscription.inbox for inbox in self._inboxes[object])
            if self._shortcut is None and is_here and self._is_open:
                self._shortcut = Shortcut(subscription, self._withdraw, self._read_on)
                self._route()

    def _withdraw(self, shortcut: Shortcut) -> None:
        """Send a subscription that was slow back to its own thread."""
        with self._lock:
            if self._shortcut is shortcut:
                self._end_shortcut()
        shortcut.subscription.distrust()

    def _end_shortcut(self) -> None:
        if self._shortcut is not None:
            self._shortcut.end()
            self._shortcut = None
            self._route()

    def _lose(self, packet: Any) -> None:
        """A subscription drops a packet: counted once, however many do."""
        with self._lock:
            try:
                packet._lost  # noqa: B018
            except AttributeError:
                packet._lost = True
                self.dropped += 1

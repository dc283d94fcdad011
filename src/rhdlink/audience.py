"""Who is told of what a robot does: each subscriber with a queue and a thread of its own."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from linkcore.errors import Closed
from linkcore.stamp import Stamp
from linkcore.streaming.packet_queue import Inbox
from linkcore.streaming.policy import Policy
from linkcore.streaming.subscription import Subscription

from .update import Change, Update

__all__ = ["Audience"]


class _Seat(NamedTuple):
    kind: type
    inbox: Inbox
    names: frozenset[str] | None
    subscription: Subscription


class Audience:
    """The subscribers of one robot."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._lock = threading.Lock()
        self._seats: tuple[_Seat, ...] = ()  # replaced, never changed
        self._is_closed = False

    def subscribe(
        self,
        kind: type,
        callback: Callable[[Any], object],
        names: frozenset[str] | None,
        policy: Policy,
        deadline: float | None = None,
        on_deadline: Callable[[float], object] | None = None,
    ) -> Subscription:
        """Call `callback` with each of a kind; where that is `Update`, with these variables of it.

        Raises:
            Closed: after `close`.
        """
        inbox = Inbox(policy)

        def detach(subscription: Subscription) -> None:
            with self._lock:
                self._seats = tuple(seat for seat in self._seats if seat.subscription is not subscription)

        with self._lock:
            if self._is_closed:
                raise Closed(f"{self._name} was closed")
            subscription = Subscription(
                inbox,
                callback,
                name=f"{self._name} {kind.__name__}",
                deadline=deadline,
                on_deadline=on_deadline,
                detach=detach,
            )
            self._seats = (*self._seats, _Seat(kind, inbox, names, subscription))
        return subscription

    def has(self, kind: type) -> bool:
        """Whether anybody is told of this kind."""
        return any(seat.kind is kind for seat in self._seats)

    def wanted(self) -> frozenset[str] | None:
        """The variables that anybody wants updates of; None for all."""
        names: set[str] = set()
        for seat in self._seats:
            if seat.kind is Update:
                if seat.names is None:
                    return None
                names |= seat.names
        return frozenset(names)

    def tell(self, event: object) -> None:
        """Hand out an event to those who subscribed to its kind."""
        for seat in self._seats:
            if seat.kind is type(event):
                seat.inbox.offer((event,))

    def update(self, changes: Mapping[str, Change], received: Stamp) -> None:
        """Hand out what changed, to each the variables that it wants; nothing to those who want none of them."""
        for seat in self._seats:
            if seat.kind is Update:
                names = seat.names
                own = changes if names is None else {name: changes[name] for name in changes if name in names}
                if own:
                    seat.inbox.offer((Update(own, received),))

    def close(self, until: float) -> None:
        """Deliver what waits, until then by `time.monotonic`, and nothing more."""
        with self._lock:
            self._is_closed = True
            seats = self._seats
        for seat in seats:
            seat.subscription.finish(max(until - time.monotonic(), 0.0))

"""Who is told of what a robot does: each subscriber with a queue and a thread of its own."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from linkcore.arguments import check_callable, check_seconds
from linkcore.errors import BadValue, Closed
from linkcore.stamp import Stamp
from linkcore.streaming.packet_queue import PacketQueue
from linkcore.streaming.policy import Policy, check_lifespan, check_policy
from linkcore.streaming.subscription import Delivery, Subscription, ThreadedDelivery

from .variables.snapshot import Change, Update

__all__ = ["Subscribers"]


class _Subscriber(NamedTuple):
    event_type: type  # of what it is told
    queue: PacketQueue
    names: frozenset[str] | None
    delivery: ThreadedDelivery
    turn: threading.Lock

    def offer(self, event: object) -> None:
        # A queue takes from one thread at a time, and any thread may sync or close.
        with self.turn:
            self.queue.offer((event,))


class Subscribers:
    """The subscribers of one robot.

    Args:
        name: of the robot, for messages.
    """

    def __init__(self, name: str) -> None:
        self._name = name
        self._lock = threading.Lock()
        self._subscribers: tuple[_Subscriber, ...] = ()  # replaced, never changed: read without the lock
        self._is_closed = False

    def subscribe(
        self,
        event_type: type,
        callback: Callable[[Any], object],
        names: frozenset[str] | None,
        policy: Policy,
        lifespan: float | None = None,
        deadline: float | None = None,
        on_deadline: Callable[[float], object] | None = None,
        *,
        owner: object,
    ) -> Subscription:
        """Call `callback` with each event of a type; where that is `Update`, with these variables of it.

        Whoever holds the subscription holds `owner`.

        Raises:
            Closed: after `close`.
            BadValue: arguments that cannot be.
        """
        _check(callback, policy, deadline, on_deadline)
        queue = PacketQueue(policy, check_lifespan(lifespan))

        def detach(delivery: Delivery) -> None:
            with self._lock:
                self._subscribers = tuple(each for each in self._subscribers if each.queue is not delivery.sink)

        with self._lock:
            if self._is_closed:
                raise Closed(f"{self._name} was closed")
            name = f"{self._name} {event_type.__name__}"
            delivery = ThreadedDelivery(queue, callback, name=name, deadline=deadline, on_deadline=on_deadline)
            self._subscribers = (*self._subscribers, _Subscriber(event_type, queue, names, delivery, threading.Lock()))
        return Subscription(delivery, detach, owner)

    def has(self, event_type: type) -> bool:
        """Whether anybody is told of events of this type."""
        return any(each.event_type is event_type for each in self._subscribers)

    def wanted(self) -> frozenset[str] | None:
        """The variables that anybody wants updates of; None for all."""
        names: set[str] = set()
        for each in self._subscribers:
            if each.event_type is Update:
                if each.names is None:
                    return None
                names |= each.names
        return frozenset(names)

    def tell(self, event: object) -> None:
        """Hand out an event to those who subscribed to its type."""
        for each in self._subscribers:
            if each.event_type is type(event):
                each.offer(event)

    def update(self, changes: Mapping[str, Change], received: Stamp) -> None:
        """Hand out what changed, to each the variables that it wants; nothing to those who want none of them."""
        for each in self._subscribers:
            if each.event_type is Update:
                names = each.names
                own = changes if names is None else {name: changes[name] for name in changes if name in names}
                if own:
                    each.offer(Update(own, received))

    def close(self, until: float) -> None:
        """Deliver what waits, until then by `time.monotonic`, and nothing more."""
        with self._lock:
            self._is_closed = True
            subscribers = self._subscribers
        for each in subscribers:
            each.delivery.finish(max(until - time.monotonic(), 0.0))


def _check(callback: object, policy: Policy, deadline: float | None, on_deadline: object) -> None:
    check_callable(callback, "callback")
    check_policy(policy)
    if deadline is not None:
        check_seconds(deadline, "deadline", positive=True)
    if on_deadline is not None:
        check_callable(on_deadline, "on_deadline")
        if deadline is None:
            raise BadValue("on_deadline was given without a deadline")

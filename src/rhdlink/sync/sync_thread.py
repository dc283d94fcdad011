"""Thread that keeps a robot in sync, and the subscribers of a robot, each with a dedicated thread."""

from __future__ import annotations

import logging
import threading
import weakref
from collections import deque
from collections.abc import Callable, Mapping
from typing import Any

from linkcore import clock
from linkcore.arguments import check_callable, check_seconds
from linkcore.clock import Stamp
from linkcore.errors import BadValue, Closed, RemoteError
from linkcore.names import StrictAttributes
from linkcore.streaming.connection_life import Backoff
from linkcore.streaming.packet_queue import PacketQueue, Policy, check_lifespan, check_policy
from linkcore.streaming.subscription import Subscription, ThreadedDelivery, check_deadline
from linkcore.threads import Closing, ReentrantEvent, started

from ..variables.snapshot import Change, Update

_log = logging.getLogger(__name__)


class SyncThread(StrictAttributes, Closing):
    """Dedicated thread that syncs until it is closed. It can be used as a context manager.

    `Variables.background` makes it. The thread does not keep the robot object alive, and ends when the program drops
    its last reference to the robot.

    Attributes:
        syncs: Number of successful syncs.
        failures: Number of syncs that failed because of the robot or the network.
        failure: Error that ended the thread: the last `RemoteError` when the back-off ran out, or any other exception
            of `sync`. None while the thread runs, and after `close`.

    Raises:
        BadValue: If `period` is not a positive number.
        LocalError: If the system cannot start another thread.
    """

    def __init__(
        self, sync: Callable[[], object], period: float | None, backoff: Backoff | None = None, *, name: str
    ) -> None:
        if period is not None:
            period = check_seconds(period, "period", positive=True, finite=True)
        if backoff is not None and not isinstance(backoff, Backoff):
            raise BadValue(f"backoff={backoff!r}; expected rhdlink.Backoff(...)")
        self.syncs = 0
        self.failures = 0
        self.failure: BaseException | None = None
        self._sync = weakref.WeakMethod(sync)
        self._period = period
        self._backoff = backoff or Backoff()
        self._closing = ReentrantEvent()
        # Set the attribute before the thread runs, because the thread might fail, and log its name, before `started`
        # returns.
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        started(self._thread)

    @property
    def is_running(self) -> bool:
        """Whether the thread is still syncing."""
        return self.failure is None and self._thread.is_alive()

    def close(self, timeout: float = 2.0) -> None:
        """Stop syncing, after waiting up to `timeout` seconds for a running sync. Idempotent."""
        self._closing.set()
        if self._thread is not threading.current_thread():
            clock.join(self._thread, timeout)

    def __repr__(self) -> str:
        state = "running" if self.is_running else "ended" if self.failure is None else f"ended by {self.failure!r}"
        return f"<{type(self).__name__} {self._thread.name}, {state}, {self.syncs} syncs, {self.failures} failed>"

    def _run(self) -> None:
        try:
            self._sync_until_closed()
        except BaseException as error:  # SystemExit too; otherwise no other thread would notice it
            _log.exception("%s ended because of an exception", self._thread.name)
            self.failure = error

    def _sync_until_closed(self) -> None:
        waits = self._backoff.waits()
        due = clock.now()
        while not self._closing.is_set():
            sync = self._sync()
            if sync is None:  # the program has dropped the robot
                return
            try:
                sync()
            except Closed:
                return
            except RemoteError as error:
                if self._closing.is_set():
                    return
                self.failures += 1
                if self.failures & (self.failures - 1) == 0:  # log only each power of two
                    _log.warning("%s: sync failed (%d failures so far): %s", self._thread.name, self.failures, error)
                wait = next(waits, None)
                if wait is None:
                    self.failure = error
                    return
            else:
                wait = None
                self.syncs += 1
                waits = self._backoff.waits()  # after a success, begin with the shortest delay again
            finally:
                del sync  # otherwise the robot object would live as long as this thread waits
            if wait is not None:
                clock.wait(self._closing.wait, wait)
                due = clock.now()
            elif self._period is not None:
                # Use absolute deadlines. A missed deadline is skipped and not made up for.
                due = max(due + self._period, clock.now())
                clock.wait(self._closing.wait, due - clock.now())


class _Subscriber:
    """Callback with the events to which it has subscribed.

    Args:
        event_type: Class of the events.
        queue: Queue of the callback.
        names: Names of the wanted variables; None for all.
        delivery: Delivery that calls the callback.
    """

    def __init__(
        self, event_type: type, queue: PacketQueue, names: frozenset[str] | None, delivery: ThreadedDelivery
    ) -> None:
        self.event_type, self.queue, self.names, self.delivery = event_type, queue, names, delivery
        # Only one thread at a time can add to a queue, but any thread can sync or close.
        self._turn = threading.RLock()
        self._waiting: deque[object] = deque()
        self._is_offering = False

    def offer(self, event: object) -> None:
        """Put an event into the queue.

        If a signal handler has interrupted its own thread inside the queue, the event is left to this thread.
        """
        with self._turn:
            self._waiting.append(event)
            if self._is_offering:
                return
            self._is_offering = True
            try:
                while self._waiting:
                    self.queue.offer((self._waiting.popleft(),))
            finally:
                self._is_offering = False


class Subscribers:
    """Collection of all subscribers of one robot.

    Args:
        name: Address of the robot, used in error messages and thread names.
    """

    def __init__(self, name: str) -> None:
        self._name = name
        # No lock is used, because a signal handler might subscribe or close while its own thread is changing this dict.
        # Each entry is added or removed in one step.
        self._by_queue: dict[PacketQueue, _Subscriber] = {}
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
        """Call `callback` with each event of a type.

        For `Update`, it receives only the variables in `names`.

        The subscription keeps `owner` alive.

        Raises:
            Closed: If the subscribers were closed.
            BadValue: If an argument is not valid.
        """
        check_callable(callback, "callback")
        check_policy(policy)
        deadline = check_deadline(deadline, on_deadline)
        queue = PacketQueue(policy, check_lifespan(lifespan))

        name = f"{self._name} {event_type.__name__}"
        delivery = ThreadedDelivery(queue, callback, name=name, deadline=deadline, on_deadline=on_deadline)
        self._by_queue[queue] = _Subscriber(event_type, queue, names, delivery)
        if self._is_closed:  # checked last, so that a `close` that missed this callback is noticed here
            delivery.close(0.0)
            self._by_queue.pop(queue, None)
            raise Closed(f"{self._name} was closed")
        return Subscription(delivery, lambda delivery: self._by_queue.pop(delivery.sink, None), owner)

    @property
    def _subscribers(self) -> list[_Subscriber]:
        return list(self._by_queue.values())

    def tell(self, event: object) -> None:
        """Deliver an event to the subscribers of its type."""
        for each in self._subscribers:
            if each.event_type is type(event):
                each.offer(event)

    def update(self, changes_of: Callable[[frozenset[str] | None], Mapping[str, Change]], received: Stamp) -> None:
        """Deliver changes to each subscriber that wants at least one of the changed variables.

        Args:
            changes_of: Function that returns the changes of the named variables, or of all for None. Called only if
                there is a subscriber.
            received: Time at which the changes arrived.
        """
        wanting = [each for each in self._subscribers if each.event_type is Update]
        if not wanting:
            return
        is_for_all = any(each.names is None for each in wanting)
        wanted = {name for each in wanting if each.names is not None for name in each.names}
        changes = changes_of(None if is_for_all else frozenset(wanted))
        for each in wanting:
            names = each.names
            own = changes if names is None else {name: changes[name] for name in changes if name in names}
            if own:
                each.offer(Update(own, received))

    def close(self, until: float) -> None:
        """Deliver the queued events until the deadline `until`, and then no more.

        The deadline is on the clock `linkcore.clock.now`.
        """
        self._is_closed = True
        for each in self._subscribers:
            each.delivery.finish(clock.left(until))

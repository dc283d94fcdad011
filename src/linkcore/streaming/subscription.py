"""Subscribed callbacks. A dedicated thread with a queue calls each callback, or the reader of the stream calls it.

The threads refer to a `Delivery` and never to a `Subscription`. So a stream without references can be garbage-collected
while its threads still run.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from typing import Any

from .. import clock
from ..arguments import check_callable, check_seconds
from ..errors import BadValue
from ..names import StrictAttributes
from ..threads import Closing, started
from .packet_queue import PacketQueue
from .statistics import SLOW_INLINE, StreamCounters, SubscriptionStatistics, snapshot

_log = logging.getLogger(__name__)

_NEVER = float("inf")

#: Interval in s at which a thread checks whether an inline call has ended.
_LOOK = 0.001


def check_deadline(deadline: float | None, on_deadline: Callable[[float], object] | None) -> float | None:
    """Return the deadline of a subscription, in s.

    Raises:
        BadValue: If it is not a positive number of seconds, or if `on_deadline` is not callable or has no deadline.
    """
    if deadline is not None:
        deadline = check_seconds(deadline, "deadline", positive=True)
    if on_deadline is not None:
        check_callable(on_deadline, "on_deadline")
        if deadline is None:
            raise BadValue("on_deadline was given without a deadline; give deadline as well")
    return deadline


def never() -> bool:
    """Return False: a callback needs each packet."""
    return False


class Delivery:
    """Delivery of packets to one callback, one packet at a time, with counters of the results.

    Args:
        callback: Function that is called with each packet, or with each of its parts.
        name: Name, used in the log and for threads.
        expand: Function that returns the parts of a packet for the callback; None to pass the packet itself.
        deadline: Maximum time between two packets, in seconds; None for no limit.
        on_deadline: Function that is called with the seconds since the last packet, once per missed deadline.

    Attributes:
        sink: Object to which the fan-out offers packets.
        missed_deadlines: Number of times that no packet arrived in time.
    """

    def __init__(
        self,
        callback: Callable[[Any], object],
        *,
        name: str,
        expand: Callable[[Any], Iterable[Any]] | None = None,
        deadline: float | None = None,
        on_deadline: Callable[[float], object] | None = None,
    ) -> None:
        self.name = name
        self._callback = callback if expand is None else _for_each(callback, expand)
        self._deadline = deadline
        self._on_deadline = on_deadline
        self._delivered = 0
        self._raised = 0
        self._is_calling = False
        self._last = clock.now()  # arrival of the last packet; updated only if there is a deadline
        self._reported = -1.0  # value of `_last` for which `on_deadline` was called
        self.missed_deadlines = 0

    @property
    def sink(self) -> Any:
        """Object to which the fan-out offers packets."""
        raise NotImplementedError

    @property
    def statistics(self) -> SubscriptionStatistics:
        """Counters at this moment."""
        return snapshot(self._look)

    def _look(self) -> SubscriptionStatistics:
        sink = self.sink
        return SubscriptionStatistics(
            offered=sink.offered,
            delivered=self._delivered + sink.taken_in_place,
            dropped=sink.dropped,
            raised=self._raised,
            waiting=sink.waiting + self._is_calling,
            missed_deadlines=self.missed_deadlines,
            expired=sink.expired,
        )

    def close(self, timeout: float) -> None:
        """Stop accepting packets, drop queued ones, and wait up to `timeout` seconds for a running callback."""
        raise NotImplementedError

    def finish(self, timeout: float = 5.0) -> bool:
        """Stop accepting packets, and deliver queued ones.

        Return False if this takes longer than `timeout`.
        """
        self.sink.end()
        return self.join(timeout)

    def join(self, timeout: float) -> bool:
        """Wait until no more packets arrive and all are delivered.

        Return False after `timeout`, and always if called in the callback itself.
        """
        raise NotImplementedError

    def runs_here(self) -> bool:
        """Whether the current thread is in the callback."""
        raise NotImplementedError

    def _fail(self) -> None:
        self._raised += 1
        count = self._raised
        # Log at each power of two, because a failing callback at 500 Hz must not fill the disk.
        if count & (count - 1) == 0:
            _log.exception("callback of %s raised; its subscription continues (%d so far)", self.name, count)

    def _late(self, deadline: float) -> float:
        """Call `on_deadline` if it is due; return the seconds until the next check."""
        last = self._last
        age = clock.now() - last
        if age < deadline:
            return deadline - age
        if self._reported != last:  # `on_deadline` is called once for each missed deadline
            self._reported = last
            self._miss(age)
        return deadline

    def _miss(self, age: float) -> None:
        self.missed_deadlines += 1
        if self._on_deadline is None:
            _log.warning("%s: nothing was received for %.3f s", self.name, age)
            return
        try:
            self._on_deadline(age)
        except BaseException:
            _log.exception("on_deadline of %s raised", self.name)


def _for_each(callback: Callable[[Any], object], expand: Callable[[Any], Iterable[Any]]) -> Callable[[Any], object]:
    """Return a callback that is called with each part of a packet, even if it raises for another part."""

    def call(packet: Any) -> None:
        failure: BaseException | None = None
        for part in expand(packet):
            try:
                callback(part)
            except BaseException as error:
                failure = error
        try:
            if failure is not None:
                raise failure
        finally:
            failure = None  # breaks the reference cycle between the error and this frame

    return call


class ThreadedDelivery(Delivery):
    """Delivery that takes packets out of a queue in a dedicated thread.

    If a callback raises any exception, only this packet is lost. This includes `SystemExit` from ``sys.exit()``, which
    would otherwise end the thread without a message.

    Args:
        queue: Queue that only this callback uses.
        callback: See `Delivery`.
        gather: Seconds for which packets are collected before they are delivered together. The reader then does not
            have to wake this thread for each packet.

    Raises:
        LocalError: If the system has no thread left.
    """

    def __init__(
        self, queue: PacketQueue, callback: Callable[[Any], object], *, gather: float = 0.0, **options: Any
    ) -> None:
        super().__init__(callback, **options)
        self._queue = queue
        self._gather = gather
        self._thread = started(threading.Thread(target=self._run, name=self.name, daemon=True))

    @property
    def sink(self) -> PacketQueue:
        return self._queue

    def close(self, timeout: float) -> None:
        self._queue.close()
        self.join(timeout)

    def join(self, timeout: float) -> bool:
        if not self.runs_here():
            clock.join(self._thread, timeout)
        return not self._thread.is_alive()

    def runs_here(self) -> bool:
        return threading.current_thread() is self._thread

    def _run(self) -> None:
        take, callback, deadline = self._queue.next, self._callback, self._deadline
        wait = 0.0 if self._gather else deadline
        while True:
            packet = take(wait)
            if packet is not None:
                self._is_calling = True
                try:
                    callback(packet)
                    self._delivered += 1
                except BaseException:
                    self._fail()
                self._is_calling = False
                del packet  # it must not be kept while waiting for the next one
                if deadline is not None:
                    self._last = clock.now()
                    wait = deadline
            elif self._queue.is_over:
                return
            elif self._gather:
                # During this sleep, no thread waits on the queue, so the reader does not have to wake a thread.
                clock.sleep(self._gather)
            elif deadline is not None:
                wait = self._late(deadline)


class InlineDelivery(Delivery):
    """Delivery that calls back in the thread that reads the stream, without a queue.

    If there is a deadline, a dedicated thread watches it.

    Args:
        callback: See `Delivery`.
        counters: Counters of the stream, which include the slow calls.
        reads_here: Function that returns whether the current thread is the reader.
        only_changes: Function that returns whether the callback currently needs no steady packets.
        on_steady: Function that is called with the last of several steady packets if the callback does not need them.

    Attributes:
        offered: Number of packets that were offered.
        only_changes: See the argument.
    """

    #: Inline callbacks get packets after the queues, so that a slow callback does not delay subscribers with their own
    #: threads.
    is_inline = True
    #: The callback is called at once, so no packet could be delivered later.
    makes_reader_wait = False
    dropped = expired = waiting = taken_in_place = 0

    def __init__(
        self,
        callback: Callable[[Any], object],
        counters: StreamCounters,
        reads_here: Callable[[], bool],
        only_changes: Callable[[], bool] = never,
        on_steady: Callable[[Any], object] | None = None,
        **options: Any,
    ) -> None:
        super().__init__(callback, **options)
        self.only_changes = only_changes
        self._on_steady = on_steady
        self._counters = counters
        self.offered = 0
        # The reader sets its flag, and then checks whether this is closed. A thread that closes marks it closed, and
        # then checks the flag. So at least one of the two threads notices the other, without a lock for each packet.
        self._is_closed = False
        self._reads_here = reads_here
        self._closing = threading.Condition()

    def begin(self) -> None:
        """Start to watch the deadline, if there is one.

        Call it after the first connection was made, because connecting might take longer than the deadline.

        Raises:
            LocalError: If the system has no thread left.
        """
        if self._deadline is not None:
            self._last = clock.now()
            started(threading.Thread(target=self._watch, name=f"{self.name} deadline", daemon=True))

    @property
    def sink(self) -> InlineDelivery:
        return self

    def offer(self, packets: Sequence[Any]) -> None:
        """Call back with each packet, immediately and in this thread."""
        # `clock.ticks` is looked up once for each batch, but not kept longer, because simulated time replaces it.
        callback, ticks = self._callback, clock.ticks
        now = ticks()
        self._is_calling = True
        for packet in packets:
            if self._is_closed:
                break
            self.offered += 1
            try:
                callback(packet)
                self._delivered += 1
            except BaseException:
                self._fail()
            began, now = now, ticks()
            if now - began > SLOW_INLINE:
                self._counters.slow_inline += 1
        self._is_calling = False
        if self._deadline is not None:
            self._last = clock.now()

    def offer_steady(self, packets: Sequence[Any]) -> None:
        """Count packets that the callback does not need, because `only_changes` has just returned True.

        They count as delivered, because the callback would see nothing new in them.
        """
        if self._is_closed:
            return
        count = len(packets)
        self.offered += count
        self._delivered += count
        if self._on_steady is not None:
            self._on_steady(packets[-1])

    def end(self) -> None:
        """Accept no more packets. Idempotent."""
        with self._closing:
            self._is_closed = True
            self._closing.notify_all()

    def close(self, timeout: float = 0.0) -> None:
        self.end()
        self.join(timeout)

    def join(self, timeout: float) -> bool:
        until = clock.now() + timeout
        if not self._waits_closed(timeout):
            return False
        while self._is_calling and not self._reads_here():
            if clock.now() >= until:
                return False
            clock.sleep(_LOOK)
        return True

    def _waits_closed(self, timeout: float) -> bool:
        with self._closing:
            return clock.wait(partial(self._closing.wait_for, lambda: self._is_closed), timeout)

    def runs_here(self) -> bool:
        return self._is_calling and self._reads_here()

    def _watch(self) -> None:
        assert self._deadline is not None
        wait = self._deadline
        while not self._waits_closed(wait):
            wait = self._late(self._deadline)


class Subscription(StrictAttributes, Closing):
    """Subscription of a callback. The callback gets packets in order, one at a time, until the subscription is closed.

    `Stream.subscribe` returns it. Use it as a context manager to close it at the end of a block. You do not have to
    store the object: the callback is called for as long as the stream is open.
    """

    def __init__(self, delivery: Delivery, detach: Callable[[Delivery], object], owner: object) -> None:
        self._delivery = delivery
        self._detach = detach
        self._owner = owner  # prevents the garbage collection of the stream

    @property
    def name(self) -> str:
        """Name of the stream and of the class of packets."""
        return self._delivery.name

    @property
    def stats(self) -> SubscriptionStatistics:
        """Counters at this moment."""
        return self._delivery.statistics

    def close(self, timeout: float = 1.0) -> None:
        """Stop delivering; queued packets are dropped and counted.

        Idempotent; may be called from the callback. Waits up to `timeout` seconds for a running callback. After that,
        the callback is left to end on its own.

        Raises:
            BadValue: If `timeout` is not a number of seconds.
        """
        timeout = check_seconds(timeout, "timeout")
        self._detach(self._delivery)
        self._delivery.close(timeout)

    def finish(self, timeout: float = 5.0) -> bool:
        """Accept no more packets, and deliver the queued ones.

        Return False if this takes longer than `timeout`.

        Raises:
            BadValue: If `timeout` is not a number of seconds.
        """
        timeout = check_seconds(timeout, "timeout")
        self._detach(self._delivery)
        return self._delivery.finish(timeout)

    def join(self, timeout: float | None = None) -> bool:
        """Wait until no more packets arrive, as after a recording, and all are delivered.

        Return False after `timeout` seconds.

        Args:
            timeout: Maximum wait in seconds; None for no limit.

        Raises:
            BadValue: If `timeout` is not a number of seconds.
        """
        return self._delivery.join(_NEVER if timeout is None else check_seconds(timeout, "timeout"))

    def __repr__(self) -> str:
        stats = self.stats
        counted = ", ".join(f"{getattr(stats, name)} {name}" for name in ("delivered", "dropped", "raised", "waiting"))
        return f"<Subscription {self.name}: {counted}>"

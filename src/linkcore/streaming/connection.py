"""Connection to one peer that reconnects automatically, with its subscribers and the thread that reads it.

    transport -> receiver -> fan-out -> queues -> callbacks
    [------ reader thread --------]   [own threads]

Connections are internal objects of the library. Users get a `Stream` or a `Feed`, which refers to a connection. The
reader thread also refers to its connection, so the connection exists until it is closed. `linkcore.aio.loop_connection`
contains the variant that an event loop reads. This variant replaces only the methods of the section "the reader".
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from functools import partial
from typing import Any

from .. import clock
from ..clock import Stamp
from ..errors import Cancelled, Closed, ConnectionLost, LinkTimeout, LocalError, RemoteError, unraised
from ..net.transport import Finished, Transport
from ..process import HomeProcess
from ..text import printable
from ..threads import alone, is_mine, started
from ..wire.framing import PacketProtocol
from .connection_life import (
    STATES,
    Backoff,
    ConnectionEvent,
    ConnectionLife,
    ConnectionPhase,
    ConnectionState,
    LifeEvent,
)
from .fanout import FanOut, Sink
from .flight_record import FlightRecord
from .packet_queue import PacketQueue, Policy
from .receiver import DeferredReceiver, Receiver
from .scheduling import urgent
from .silence import SilenceMonitor
from .statistics import StreamCounters
from .subscription import InlineDelivery, Subscription, ThreadedDelivery, never

_log = logging.getLogger(__name__)


class Connection:
    """Connection with its subscribers. A dedicated thread reads it.

    It connects when it is first used.

    Args:
        name: Name, used for messages and threads.
        transport: Transport that provides the bytes.
        protocol: Function that returns a new protocol for each connection.
        fan_out: Fan-out that distributes the packets to the subscribers.
        backoff: Waits between the attempts to reconnect.
        timeout: Maximum time for connecting, in s.
        silence: Seconds without a packet after which the connection is considered lost; None for no limit.
        flight: Record of the last received bytes; None to keep no record.

    Attributes:
        silence: Monitor of the silence of the peer.
        flight: See the argument `flight`.
    """

    def __init__(
        self,
        name: str,
        transport: Transport,
        protocol: Callable[[], PacketProtocol],
        fan_out: FanOut,
        *,
        backoff: Backoff | None = None,
        timeout: float = 5.0,
        silence: float | None = 2.0,
        flight: FlightRecord | None = None,
    ) -> None:
        self.name = name
        self.fan_out = fan_out
        self.flight = flight
        self.counters = StreamCounters()
        self.silence = SilenceMonitor(name, silence)
        self._transport = transport
        self._protocol = protocol
        self._timeout = timeout
        self._home = HomeProcess(name)
        # The following attributes change under this condition. Its lock is re-entrant, because a signal handler, or the
        # garbage collection of a stream, can run between any two instructions of the thread that holds the lock.
        self._lock = threading.RLock()
        self._changed = threading.Condition(self._lock)
        self._life = ConnectionLife(name, backoff or Backoff())
        self._sending = threading.RLock()
        self._reader: threading.Thread | None = None

    @property
    def state(self) -> ConnectionState:
        """Current state of the connection."""
        return STATES[self._life.phase]

    @property
    def failure(self) -> Exception | None:
        """Error that ended the connection permanently, as a copy that may be raised.

        It is None if the connection was closed on purpose.
        """
        failure = self._life.failure
        return None if failure is None else unraised(failure)

    @property
    def error(self) -> Exception | None:
        """Error that ended the last connection or attempt to connect, as a copy that may be raised."""
        error = self._life.error
        return None if error is None else unraised(error)

    # -- beginning and ending --------------------------------------------------------------------

    @property
    def is_over(self) -> bool:
        """Whether no packet will ever arrive again."""
        return self._life.is_over

    def start(self, add: Callable[[], object] | None = None) -> None:
        """Connect if it has not connected yet, and wait until it is connected.

        Args:
            add: Function that is called before any packet can arrive.

        Raises:
            RemoteError: If connecting fails; the next use tries again.
            LocalError: If the system has no thread left, if the reader calls this while it is not connected, or if this
                process was forked from the process that made the connection.
            Closed: If the connection was closed.
        """
        self._home.check()  # before `_lock` is acquired: a thread of the parent might hold it
        is_again = is_mine(self._lock)
        with self._changed:
            if self._life.is_ending or not self._is_settled:
                self.refuse_to_wait("connecting")
                if is_again:  # the interrupted call cannot continue while this signal handler waits
                    raise LinkTimeout(
                        f"{self.name} is still connecting, and this signal handler interrupted the connecting call; "
                        "wait for it after the handler has returned"
                    )
            # A reader that ends closes its subscriptions. A new subscription belongs to the next reader.
            if self._life.is_ending:
                clock.wait(partial(self._changed.wait_for, lambda: not self._life.is_ending), self._timeout)
            if add is not None:
                add()
            self._begin(is_patient=False)
            if self._life.is_closed:
                raise Closed(f"{self.name} was closed")
            attempt = self._life.attempt
            if not attempt.is_settled and not clock.wait(
                partial(self._changed.wait_for, lambda: attempt.is_settled), self._timeout + 1.0
            ):
                raise self.error or LinkTimeout(f"{self.name}: no connection within {self._timeout:g} s")
        if attempt.failure is not None:
            raise unraised(attempt.failure)

    def start_quietly(self) -> None:
        """Start to connect if it has not connected yet, without waiting.

        Failures are retried with the back-off.
        """
        if self._life.phase is ConnectionPhase.IDLE:
            with self._changed:
                self._begin(is_patient=True)

    @property
    def _is_settled(self) -> bool:
        """Whether `start` does not have to wait, because the connection was made once, or was closed."""
        return self._life.phase is not ConnectionPhase.IDLE and self._life.attempt.is_settled

    def _begin(self, is_patient: bool) -> None:
        """Start the reader if none runs. The caller holds the lock."""
        if not self._life.use(is_patient, self.counters.received):
            return
        try:
            self._launch()
        except LocalError:
            self._life.fire(LifeEvent.REST)
            raise

    def join(self, timeout: float) -> bool:
        """Wait until no more packets will arrive and all are delivered.

        Return False after `timeout` seconds.
        """
        until = clock.now() + timeout
        if not self._join_reader(timeout):
            return False
        return all(delivery.join(clock.left(until)) for delivery in self.fan_out.deliveries)

    def close(self, timeout: float) -> None:
        """Disconnect and end every queue and callback, within `timeout` seconds.

        Idempotent, and safe in any thread. In a forked process this does nothing, because the connection belongs to the
        parent, and its threads do not exist in the child.
        """
        if not self._home.is_here:
            return
        until = clock.now() + timeout
        self._stop()
        self.fan_out.close(all=False)
        self._hang_up()
        has_ended = self._join_reader(timeout)
        for delivery in self.fan_out.deliveries:
            delivery.join(clock.left(until))
            if isinstance(delivery, InlineDelivery):  # an inline delivery refers to this connection
                self.fan_out.remove_delivery(delivery)
        if not has_ended:
            self.fan_out.close(all=True)

    def abandon(self) -> None:
        """End everything without waiting. In a forked process this does nothing."""
        if not self._home.is_here:
            return
        self._stop()
        self._transport.abort()

    def _stop(self) -> None:
        with self._changed:
            self._life.fire(LifeEvent.CLOSE)
            self._life.attempt.is_settled = True
            self._changed.notify_all()

    # -- sending ---------------------------------------------------------------------------------

    def send(self, data: bytes, timeout: float) -> None:
        """Send `data` on the current connection, completely or not at all from the view of the peer.

        Connect first if the connection has never been made. Data is never stored for later: if it cannot be sent now,
        it is discarded. If the peer does not accept all of the data in time, the connection is aborted, because the
        peer would read any later data as the missing part.

        Raises:
            LinkTimeout: If the peer does not accept the data within `timeout` seconds. Also if a signal handler calls
                this after it has interrupted another call of `send`, because a part of the bytes of that call might
                have been sent.
            RemoteError, LocalError, Closed: See `start` and `send_some`.
        """
        self.start()
        until = clock.now() + timeout
        rest = memoryview(data)
        otherwise = f"{self.name}: another call did not finish sending within {timeout:g} s"
        with alone(self._sending, timeout, otherwise):
            while rest:
                try:
                    sent = self.send_some(rest)
                except Cancelled:
                    if len(rest) < len(data):
                        self.abort()
                    raise
                rest = rest[sent:]
                if not sent and not self.wait_for_room(clock.left(until)):
                    self.abort()
                    raise LinkTimeout(f"{self.name} did not accept the sent data within {timeout:g} s")

    def send_some(self, data: bytes | memoryview) -> int:
        """Pass to the kernel as many bytes as it accepts at once; return their number.

        This method never waits, and acquires no lock.

        Raises:
            ConnectionLost: If there is currently no connection.
            Closed: If the connection was closed, or has ended.
        """
        if self.state is not ConnectionState.CONNECTED:
            if self.is_over:
                raise Closed(f"{self.name} was closed, or has ended")
            because = f": {self.error}" if self.error is not None else ""
            raise ConnectionLost(f"{self.name} is not connected{because}")
        return self._transport.send_some(data)

    def wait_for_room(self, timeout: float) -> bool:
        """Wait until data can be sent; return False after `timeout` seconds.

        Raises:
            ConnectionLost: If the connection is lost.
        """
        return self._transport.wait_for_room(timeout)

    def abort(self) -> None:
        """Abort the connection, discard the data that the peer has not acknowledged, and reconnect."""
        self._transport.abort()

    # -- subscribers -----------------------------------------------------------------------------

    def open_queue(self, kind: type, policy: Policy, lifespan: float | None = None) -> PacketQueue:
        """Return a new queue of packets that are or contain a `kind`.

        Connect if it has not connected yet. The caller must close the queue with `close_queue`.

        Raises:
            RemoteError, LocalError, Closed: See `start`.
        """
        queue = PacketQueue(policy, lifespan)
        self._join(queue, kind)
        return queue

    def _join(self, sink: Sink, kind: type) -> None:
        """Start offering packets to `sink`; connect if it has not connected yet."""
        try:
            self.start(lambda: self.fan_out.add(sink, kind))
        except BaseException:
            self.fan_out.remove(sink)
            sink.close()
            raise
        if self.is_over:
            sink.end()

    def close_queue(self, queue: PacketQueue) -> None:
        """Remove a queue; its packets are dropped and counted."""
        self.fan_out.remove(queue)
        queue.close()

    def subscribe(
        self,
        kind: type,
        callback: Callable[[Any], object],
        *,
        policy: Policy,
        lifespan: float | None = None,
        deadline: float | None = None,
        on_deadline: Callable[[float], object] | None = None,
        gather: float = 0.0,
        in_place: Callable[[Any], bool] | None = None,
        owner: object = None,
    ) -> Subscription:
        """Subscribe a callback with a dedicated thread and a dedicated queue.

        Args:
            kind, callback, policy, lifespan, deadline, on_deadline, owner: See `Feed.subscribe`.
            gather: See `ThreadedDelivery`.
            in_place: See `BoundedQueue.take_in_place`.

        Raises:
            RemoteError, Closed: See `start`.
            LocalError: See `start`. Also if the system has no thread left for the callback.
        """
        queue = self.open_queue(kind, policy, lifespan)
        queue.take_in_place = in_place
        options = self._options(kind, deadline, on_deadline)
        try:
            delivery = ThreadedDelivery(queue, callback, gather=gather, **options)
        except LocalError:
            self.close_queue(queue)
            raise
        self.fan_out.add_delivery(delivery)
        return Subscription(delivery, self.fan_out.remove_delivery, owner)

    def subscribe_inline(
        self,
        kind: type,
        callback: Callable[[Any], object],
        *,
        deadline: float | None = None,
        on_deadline: Callable[[float], object] | None = None,
        only_changes: Callable[[], bool] = never,
        on_steady: Callable[[Any], object] | None = None,
        owner: object = None,
    ) -> Subscription:
        """Subscribe a callback that the reader calls.

        Args:
            kind, callback, deadline, on_deadline, owner: See `Feed.subscribe`.
            only_changes: Function that returns whether the callback currently needs no steady packets, because it looks
                only at modes and signals; see `linkcore.deferred.Deferred.is_steady`.
            on_steady: Function that is called with the last of several steady packets if the callback does not need
                them. It must be quick, and must not raise an exception.

        Raises:
            RemoteError, LocalError, Closed: See `start`.
        """
        delivery = InlineDelivery(
            callback,
            self.counters,
            self.reads_here,
            only_changes=only_changes,
            on_steady=on_steady,
            **self._options(kind, deadline, on_deadline),
        )
        self._join(delivery, kind)
        try:
            delivery.begin()
        except LocalError:
            self.fan_out.remove(delivery)
            delivery.close()
            raise
        self.fan_out.add_delivery(delivery)
        return Subscription(delivery, self.fan_out.remove_delivery, owner)

    def _options(
        self, kind: type, deadline: float | None, on_deadline: Callable[[float], object] | None
    ) -> dict[str, Any]:
        name = f"{self.name} {kind.__name__}"
        expand = self.fan_out.expander(kind)
        return {"name": name, "expand": expand, "deadline": deadline, "on_deadline": on_deadline}

    # -- events, for every kind of reader --------------------------------------------------------

    def _connecting(self) -> None:
        """Publish that the reader is about to connect."""
        with self._changed:
            news = self._life.fire(LifeEvent.CONNECT)
        self._tell(news)

    def _opened(self) -> Receiver:
        """Publish that the transport is open; return the receiver of the new connection."""
        protocol = self._protocol()
        if self.flight is not None:
            self.flight.keep(b"")
            self.flight.keep(clock.now())
        self.counters.connected(protocol, self._transport.round_trip)
        with self._changed:
            news = self._life.fire(LifeEvent.OPEN)
            self._life.attempt.has_opened = True
        self._tell(news)
        self._settle()
        if getattr(self._transport, "delivers_deferred", False):
            receiver = DeferredReceiver(self.name, protocol, self.counters, self.flight)
            take: Any = partial(self._take_in_place, receiver)
            self._transport.accept_deferred(self.fan_out.takes_batches, take)  # type: ignore[attr-defined]
            return receiver
        return Receiver(self.name, protocol, self.counters, self.flight)

    def _settle(self) -> None:
        with self._changed:
            self._life.attempt.is_settled = True
            self._changed.notify_all()

    def _next_try(self, error: Exception | None) -> float | None:
        """Process the end of a connection, or a failed attempt to connect.

        Return the seconds until the next try.

        Args:
            error: Error that ended the connection; None if it was closed while it was connecting.

        Returns:
            Seconds to wait before the next try; None if the reader must end.
        """
        if isinstance(error, Finished):
            self._finish(None)
            return None
        if error is not None and not isinstance(error, RemoteError):
            _log.error("%s: the reader failed", self.name, exc_info=error)
            self._finish(unraised(error))
            return None
        self._disconnected(error)
        if self._life.is_closed:
            self._finish(None)
            return None
        wait = self._life.retry_after(self.counters.received)
        if wait is None:
            self._finish(self._life.error)
        return wait

    def _take(self, receiver: Receiver, data: bytes, stamp: Stamp, is_steady: bool = False) -> None:
        """Decode received bytes, and publish the packets that they complete; for `is_steady`, see `FanOut.publish`.

        Raises:
            WrongPeer: If the bytes do not belong to such a stream.
            LinkTimeout: If the peer has sent no complete packet for too long.
        """
        fan_out, silence = self.fan_out, self.silence
        if fan_out.taps:
            fan_out.tap(data, receiver.rest, stamp)
        packets = receiver.feed_steady(data, stamp) if is_steady else receiver.feed(data, stamp)
        if packets:
            silence.last = stamp[0]
            if silence.is_quiet:
                silence.end(stamp[0])
            fan_out.publish(packets, is_steady)
        else:
            silence.no_packet(stamp[0])

    def _take_in_place(self, receiver: DeferredReceiver, data: Any) -> tuple[bool, float | None]:
        """Publish a steady packet of a simulated connection in place of the reader, which waits for it.

        Return whether the packet was published, and the seconds that the reader waits for the next data.
        """
        takes = self.fan_out.takes_batches if receiver.leaves_unread else self.fan_out.takes_at_once
        if not (takes() and receiver.is_next(data)):
            return False, None
        self._take(receiver, data, Stamp.now(), is_steady=True)
        return True, self.silence.wait

    def _disconnected(self, error: Exception | None) -> None:
        self._transport.abort()
        self.fan_out.forget()
        self.counters.disconnected()
        if not self._life.is_closed:
            _log.info("%s: connection lost: %s", self.name, printable(error))
        with self._changed:
            news = self._life.lose(error)
        self._tell(news, self._life.error)

    def _finish(self, failure: Exception | None) -> None:
        """End every subscription, because the reader has ended; the next use starts a new reader."""
        with self._changed:
            news = self._life.end(failure)
        self._transport.abort()
        self.counters.disconnected()
        if failure is not None or self._life.is_closed:
            # Keep the last packet of a finished recording, because it is as current as every other packet of the
            # recording.
            self.fan_out.forget()
        if failure is not None and self._life.attempt.has_opened:
            # If a program has only callbacks, the log is the only report of this failure.
            _log.warning("%s: the connection has ended and is not retried: %s", self.name, printable(failure))
        self._tell(news, failure)
        self.fan_out.end()
        with self._changed:
            self._life.fire(LifeEvent.REST)
            self._settle()

    def _tell(self, state: ConnectionState | None, error: Exception | None = None) -> None:
        if state is not None:
            self.fan_out.tell(ConnectionEvent(state, self.name, error, Stamp.now()))

    # -- the reader ------------------------------------------------------------------------------

    @property
    def is_running(self) -> bool:
        """Whether a reader was started, and has not ended."""
        reader = self._reader
        return reader is not None and reader.is_alive()

    def reads_here(self) -> bool:
        """Whether the current thread is the reader."""
        return threading.current_thread() is self._reader

    def refuse_to_wait(self, what: str) -> None:
        """Raise if the current thread would wait for itself.

        Raises:
            LocalError: If the current thread is the reader.
        """
        if self.reads_here():
            raise LocalError(
                f"{what} would wait forever: an inline callback runs in the thread that reads {self.name}, so nothing "
                "is read meanwhile; subscribe without inline=True, or wait in another thread"
            )

    def look(self) -> None:
        """Publish bytes that have already arrived, before a caller concludes that nothing has arrived.

        This does nothing here, because the reader thread publishes all bytes at once. A connection whose reader is the
        current thread overrides it.
        """

    def _launch(self) -> None:
        """Start the reader.

        Raises:
            LocalError: If the system has no thread left.
        """
        # Set the attribute before the thread starts, because the thread compares itself with it.
        self._reader = threading.Thread(target=self._read, name=f"{self.name} reader", daemon=True)
        try:
            started(self._reader)
        except LocalError:
            self._reader = None
            raise

    def _join_reader(self, timeout: float) -> bool:
        """Wait until the reader has ended; return False after `timeout` seconds."""
        reader = self._reader
        if reader is None or self.reads_here():
            return True
        return clock.join(reader, timeout)

    def _hang_up(self) -> None:
        """Disconnect after the sent data is delivered, and wake the reader. Call it after `_stop`."""
        self._transport.close()

    @urgent()
    def _read(self) -> None:
        while True:
            try:
                self._connect_and_receive()
            except Exception as error:
                wait = self._next_try(error)
            else:
                wait = self._next_try(None)
            if wait is None:
                return
            with self._changed:
                if clock.wait(partial(self._changed.wait_for, lambda: self._life.is_closed), wait):
                    break
        self._finish(None)

    def _connect_and_receive(self) -> None:
        """Connect, and receive until the transport or the protocol raises, or until it is closed."""
        self._connecting()
        self._transport.open(self._timeout)
        if not self._life.is_closed:  # a call of `close` while it was connecting could not close this socket
            self._receive(self._opened())

    def _receive(self, receiver: Receiver) -> None:
        """Publish received packets until the transport raises, or the peer has been silent for too long."""
        receive, take, silence = self._transport.receive, self._take, self.silence
        silence.end(clock.now())
        while True:
            try:
                data, stamp = receive(silence.wait)
            except LinkTimeout:
                silence.timed_out()
            else:
                take(receiver, data, stamp)

"""One connection of one peer, kept up: its life, its subscribers, sending, and the thread that reads it.

    transport -> receiver -> fan-out -> queues -> callbacks
    [------ reader thread --------]   [own threads]

The library holds connections; users hold a `Stream` or a `Feed`, which refer to one. What reads refers to its
connection too, which therefore exists until it is closed. `linkcore.aio.loop_connection` has the same for an event
loop: it replaces what is below "what reads it", and nothing else.
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
from .packet_queue import PacketQueue, Policy
from .receiver import Receiver
from .scheduling import urgent
from .silence import SilenceMonitor
from .statistics import StreamCounters
from .subscription import InlineDelivery, Subscription, ThreadedDelivery

_log = logging.getLogger(__name__)


class Connection:
    """A connection and its subscribers, read by a thread of its own. Connects when first used.

    Args:
        name: for messages and threads.
        transport: where bytes come from.
        protocol: makes the protocol of one connection.
        fan_out: hands the packets to the subscribers.
        backoff: how to connect again.
        timeout: seconds for a connection to be made.
        silence: seconds without a packet after which a connection counts as lost; None for ever.

    Attributes:
        silence: tells how long the peer has been silent.
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
    ) -> None:
        self.name = name
        self.fan_out = fan_out
        self.counters = StreamCounters()
        self.silence = SilenceMonitor(name, silence)
        self._transport = transport
        self._protocol = protocol
        self._timeout = timeout
        self._home = HomeProcess(name)
        # What follows changes under this condition. Its lock is re-entrant: a signal handler, or the collection of a
        # stream that nobody holds any more, can come between any two instructions of the thread that has it.
        self._lock = threading.RLock()
        self._changed = threading.Condition(self._lock)
        self._life = ConnectionLife(name, backoff or Backoff())
        self._sending = threading.RLock()
        self._reader: threading.Thread | None = None

    @property
    def state(self) -> ConnectionState:
        """What the connection is doing."""
        return STATES[self._life.phase]

    @property
    def failure(self) -> Exception | None:
        """What ended it, where it was not closed on purpose: a copy, which may be raised."""
        failure = self._life.failure
        return None if failure is None else unraised(failure)

    @property
    def error(self) -> Exception | None:
        """What ended the last connection, or kept the next one from being made: a copy, which may be raised."""
        error = self._life.error
        return None if error is None else unraised(error)

    # -- beginning and ending --------------------------------------------------------------------

    @property
    def is_over(self) -> bool:
        """No packet will ever come again."""
        return self._life.is_over

    def start(self, add: Callable[[], object] | None = None) -> None:
        """Connect, if nothing has yet, and wait until it is done.

        Args:
            add: is called before anything can come.

        Raises:
            RemoteError: the connection could not be made; the next use tries again.
            LocalError: the system has no thread left, or this is the reader itself, which is not connected, or a
                process that was forked from the one which made the connection.
            Closed: it was closed.
        """
        self._home.check()  # without the lock, which a thread of the parent may have held as it forked
        is_again = is_mine(self._lock)
        with self._changed:
            if self._life.is_ending or not self._is_settled:
                self.refuse_to_wait("connecting")
                if is_again:  # the interrupted thread has to go on first
                    raise LinkTimeout(
                        f"{self.name} is being connected by the call that this signal handler interrupted"
                    )
            # A reader that ends closes its subscriptions: one that begins now belongs to the next reader.
            clock.wait(partial(self._changed.wait_for, lambda: not self._life.is_ending), self._timeout)
            if self._life.is_closed:
                raise Closed(f"{self.name} was closed")
            if add is not None:
                add()
            self._begin(is_patient=False)
            attempt = self._life.attempt
            if not clock.wait(partial(self._changed.wait_for, lambda: attempt.is_settled), self._timeout + 1.0):
                raise self.error or LinkTimeout(f"{self.name}: no connection within {self._timeout:g} s")
        if attempt.failure is not None:
            raise unraised(attempt.failure)

    def start_quietly(self) -> None:
        """Begin to connect, if nothing has yet, without waiting; failures are retried by the back-off."""
        if self._life.phase is ConnectionPhase.IDLE:
            with self._changed:
                self._begin(is_patient=True)

    @property
    def _is_settled(self) -> bool:
        """Nothing is to be waited for: it has been connected once, or is closed."""
        return self._life.phase is not ConnectionPhase.IDLE and self._life.attempt.is_settled

    def _begin(self, is_patient: bool) -> None:
        """Read, if nothing does yet. With the lock."""
        if self._life.phase is not ConnectionPhase.IDLE:
            return
        self._life.use(is_patient, self.counters.received)
        try:
            self._launch()
        except LocalError:
            self._life.fire(LifeEvent.REST)
            raise

    def join(self, timeout: float) -> bool:
        """Wait until no packet will come any more and all are delivered; False when time is up."""
        until = clock.now() + timeout
        if not self._join_reader(timeout):
            return False
        return all(delivery.join(clock.left(until)) for delivery in self.fan_out.deliveries)

    def close(self, timeout: float) -> None:
        """Disconnect and end every queue and callback; within `timeout` seconds. Idempotent, from any thread.

        In a forked process this does nothing: the connection is its parent's, and its threads do not exist here.
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
            if isinstance(delivery, InlineDelivery):  # which holds this connection
                self.fan_out.remove_delivery(delivery)
        if not has_ended:
            self.fan_out.close(all=True)

    def abandon(self) -> None:
        """End everything without waiting for anything; nothing in a forked process."""
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
        """Send on the present connection, whole or not at all as far as the peer can tell; connects if nothing has yet.

        Nothing is kept for later: what cannot be sent now is not sent. Where the peer takes only a part of it in time,
        the connection is given up, since whatever followed would be read as its rest.

        Raises:
            LinkTimeout: the peer did not take it within `timeout` seconds. Or this is a signal handler that has
                interrupted another call of `send`, whose bytes may have been sent in part.
            RemoteError, LocalError, Closed: as `start` and `send_some`.
        """
        self.start()
        until = clock.now() + timeout
        rest = memoryview(data)
        otherwise = f"{self.name}: other bytes were not sent within {timeout:g} s"
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
                    raise LinkTimeout(f"{self.name} did not take what was sent within {timeout:g} s")

    def send_some(self, data: bytes | memoryview) -> int:
        """Hand to the kernel what it takes at once; its number of bytes. Neither waits nor takes a lock.

        Raises:
            ConnectionLost: there is no connection at present.
            Closed: it was closed, or is over.
        """
        if self.state is not ConnectionState.CONNECTED:
            if self.is_over:
                raise Closed(f"{self.name} was closed, or is over")
            because = f": {self.error}" if self.error is not None else ""
            raise ConnectionLost(f"{self.name} is not connected{because}")
        return self._transport.send_some(data)

    def wait_for_room(self, timeout: float) -> bool:
        """Wait until something can be sent; False when time is up.

        Raises:
            ConnectionLost: the connection is gone.
        """
        return self._transport.wait_for_room(timeout)

    def abort(self) -> None:
        """Give up what was sent: discard what the peer has not acknowledged, and connect again."""
        self._transport.abort()

    # -- subscribers -----------------------------------------------------------------------------

    def open_queue(self, kind: type, policy: Policy, lifespan: float | None = None) -> PacketQueue:
        """A queue of packets that are or hold a `kind`; connects if nothing has yet. See `close_queue`.

        Raises:
            RemoteError, LocalError, Closed: as `start`.
        """
        queue = PacketQueue(policy, lifespan)
        self._join(queue, kind)
        return queue

    def _join(self, sink: Sink, kind: type) -> None:
        """Offer packets to `sink` from now on; connects if nothing has yet."""
        try:
            self.start(lambda: self.fan_out.add(sink, kind))
        except BaseException:
            self.fan_out.remove(sink)
            sink.close()
            raise
        if self.is_over:
            sink.end()

    def close_queue(self, queue: PacketQueue) -> None:
        """Take a queue away; what waits in it is dropped and counted."""
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
        owner: object = None,
    ) -> Subscription:
        """A callback in a thread of its own, on a queue of its own.

        Raises:
            RemoteError, LocalError, Closed: as `start`; LocalError also where there is no thread for the callback.
        """
        queue = self.open_queue(kind, policy, lifespan)
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
        owner: object = None,
    ) -> Subscription:
        """A callback that the reader calls.

        Raises:
            RemoteError, LocalError, Closed: as `start`.
        """
        delivery = InlineDelivery(
            callback, self.counters, self.reads_here, **self._options(kind, deadline, on_deadline)
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

    # -- what becomes of it, whatever reads it ---------------------------------------------------

    def _connecting(self) -> None:
        """It is about to be made."""
        with self._changed:
            news = self._life.fire(LifeEvent.CONNECT)
        self._tell(news)

    def _opened(self) -> Receiver:
        """The transport is open: publish the event, and receive until the connection is lost."""
        protocol = self._protocol()
        self.counters.connected(protocol, self._transport.round_trip)
        with self._changed:
            news = self._life.fire(LifeEvent.OPEN)
            self._life.attempt.has_opened = True
        self._tell(news)
        self._settle()
        return Receiver(self.name, protocol, self.counters)

    def _settle(self) -> None:
        with self._changed:
            self._life.attempt.is_settled = True
            self._changed.notify_all()

    def _next_try(self, error: Exception | None) -> float | None:
        """A connection has ended, or could not be made: seconds until the next try, or None if it is all over.

        Args:
            error: what ended it; None where it was closed while it was made.
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

    def _take(self, receiver: Receiver, data: bytes, stamp: Stamp) -> None:
        """Hand out what bytes that have come complete.

        Raises:
            WrongPeer: they are of no such stream.
            LinkTimeout: the peer has been silent for too long, but for bytes that complete nothing.
        """
        fan_out, silence = self.fan_out, self.silence
        if fan_out.taps:
            fan_out.tap(data, receiver.rest, stamp)
        packets = receiver.feed(data, stamp)
        if packets:
            silence.last = stamp[0]
            if silence.is_quiet:
                silence.end(stamp[0])
            fan_out.publish(packets)
        else:
            silence.no_packet(stamp[0])

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
        """Nothing is read any more: end every subscription, and let the next use begin anew."""
        with self._changed:
            news = self._life.end(failure)
        self._transport.abort()
        self.counters.disconnected()
        if failure is not None or self._life.is_closed:
            self.fan_out.forget()  # the last of a recording stays: it is no older than the others
        if failure is not None and self._life.attempt.has_opened:
            # For a callback without an error handler, the log is the only report.
            _log.warning("%s: given up: %s", self.name, printable(failure))
        self._tell(news, failure)
        self.fan_out.end()
        with self._changed:
            self._life.fire(LifeEvent.REST)
            self._settle()

    def _tell(self, state: ConnectionState | None, error: Exception | None = None) -> None:
        if state is not None:
            self.fan_out.tell(ConnectionEvent(state, self.name, error, Stamp.now()))

    # -- what reads it ---------------------------------------------------------------------------

    @property
    def is_running(self) -> bool:
        """A reader has been started, and has not ended."""
        reader = self._reader
        return reader is not None and reader.is_alive()

    def reads_here(self) -> bool:
        """The current thread is the one that reads."""
        return threading.current_thread() is self._reader

    def refuse_to_wait(self, what: str) -> None:
        """Raise where the current thread would wait for itself.

        Raises:
            LocalError: it is the one that reads.
        """
        if self.reads_here():
            raise LocalError(
                f"{what} would wait for ever: it was called in an inline callback, so by the thread that reads "
                f"{self.name}, which reads nothing meanwhile; subscribe without inline=True, or wait in another thread"
            )

    def look(self) -> None:
        """Hand out what has come already, before anybody concludes that nothing has; where the current thread reads.

        Nothing to do here: the thread only reads, and waits for nothing else.
        """

    def _launch(self) -> None:
        """Start to read.

        Raises:
            LocalError: the system has no thread left.
        """
        # Known before it starts, so that it finds itself there.
        self._reader = threading.Thread(target=self._read, name=f"{self.name} reader", daemon=True)
        try:
            started(self._reader)
        except LocalError:
            self._reader = None
            raise

    def _join_reader(self, timeout: float) -> bool:
        """Wait until nothing is read any more; False when time is up."""
        reader = self._reader
        if reader is None or self.reads_here():
            return True
        return clock.join(reader, timeout)

    def _hang_up(self) -> None:
        """Disconnect once what was sent is delivered, and wake what reads. After `_stop`."""
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
        """One connection, until the transport or the protocol raises, or it is closed."""
        self._connecting()
        self._transport.open(self._timeout)
        if not self._life.is_closed:  # closed while connecting: that could not see this socket
            self._receive(self._opened())

    def _receive(self, receiver: Receiver) -> None:
        """Hand out what comes, until the transport raises or the peer has been silent for too long."""
        receive, take, silence = self._transport.receive, self._take, self.silence
        silence.end(clock.now())
        while True:
            try:
                data, stamp = receive(silence.wait)
            except LinkTimeout:
                silence.timed_out()
            else:
                take(receiver, data, stamp)

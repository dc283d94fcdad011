"""From the socket to the subscribers: the connection, and the thread that reads it.

    transport -> framer -> decoder -> distribution -> inboxes -> callbacks
    [------------------ reader thread ----------]   [own threads]

A `Stream` reconnects by itself and keeps its subscriptions meanwhile. What it hands out is typed:
`Stream.of` gives the same stream seen as the packets of one class.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Iterable
from typing import Any, TypeVar

from ..errors import BadValue, Closed, ConnectionLost, LinkTimeout, PacketError, RemoteError, WrongPeer
from ..net.transport import Finished, Transport
from ..stamp import Stamp
from ..wire.packet import State
from ..wire.protocol import PacketProtocol
from .backoff import Backoff
from .events import ConnectionEvent, ConnectionState, Traffic
from .fanout import Distribution
from .feed import Feed
from .packet_queue import Inbox
from .policy import Policy, block, drop_oldest
from .shortcut import Relieved
from .statistics import StreamStatistics, Tally
from .subscription import Subscription

__all__ = ["Stream"]

_log = logging.getLogger(__name__)

T = TypeVar("T")
K = TypeVar("K")


class Stream(Feed[T]):
    """One interface of one peer: a connection, kept up, and its subscribers.

    Connects when first used. A stream is a `Feed` of its main class.

    Args:
        name: for messages and threads.
        transport: where bytes come from.
        session: makes the protocol of one connection.
        kind: the main class of packet.
        parts: the packets inside a packet, for those who subscribe to one; None if there are none.
        backoff: how to reconnect.
        timeout: seconds for a connection to be made.
        silence: seconds without a packet after which a connection counts as lost; None for ever.
        lossless: subscriptions and iterations are `block` where they do not say otherwise.
    """

    def __init__(
        self,
        name: str,
        transport: Transport,
        session: Callable[[], PacketProtocol],
        kind: type[T],
        *,
        parts: Callable[[Any], Iterable[Any]] | None = None,
        backoff: Backoff | None = None,
        timeout: float = 5.0,
        silence: float | None = 2.0,
        lossless: bool = False,
    ) -> None:
        super().__init__(self, kind)
        self.name = name
        #: What ended the stream, where it was not closed on purpose.
        self.failure: Exception | None = None
        self._transport = transport
        self._session_factory = session
        self._session: PacketProtocol | None = None
        self._backoff = backoff or Backoff()
        self._timeout = timeout
        self._silence = silence
        self._lossless = lossless
        self._distribution = Distribution(kind, parts, self._read_on)
        self._tally = Tally()
        self._lock = threading.Lock()
        self._sending = threading.Lock()
        self._closing = threading.Event()
        self._opened = False
        self._over = False
        self._patient = False
        self._error: Exception | None = None
        self._settled = threading.Event()  # the first connection was made, or could not be
        self._reader: threading.Thread | None = None
        self._connection = ConnectionState.IDLE

    # -- what users hold -----------------------------------------------------------------------

    def of(self, kind: type[K]) -> Feed[K]:
        """The packets of another class on the same stream.

        A class of packet, of a part of one, a base class of several, `ConnectionEvent`, or `Traffic`
        for the bytes as they came.

        Raises:
            BadValue: not a class that a stream can have.
        """
        if not (isinstance(kind, type) and issubclass(kind, (State, ConnectionEvent, Traffic))):
            raise BadValue(f"{kind!r} is no class of packets; expected one such as {self._kind.__name__}")
        return Feed(self, kind)

    def subscribe(
        self,
        callback: Callable[[Any], object],
        kind: type | None = None,
        *,
        policy: Policy | None = None,
        deadline: float | None = None,
        on_deadline: Callable[[float], object] | None = None,
    ) -> Subscription:
        """As `Feed.subscribe`; with `kind`, to packets of that class: ``of(kind).subscribe(...)``."""
        if kind is not None:
            return self.of(kind).subscribe(callback, policy=policy, deadline=deadline, on_deadline=on_deadline)
        return super().subscribe(callback, policy=policy, deadline=deadline, on_deadline=on_deadline)

    @property
    def connection(self) -> ConnectionState:
        """What the connection is doing."""
        return self._connection

    @property
    def stats(self) -> StreamStatistics:
        """The counters at this moment."""
        dropped = self._distribution.dropped  # first: what was dropped has been received
        return self._tally.statistics(dropped, self._session)

    def send(self, data: bytes, timeout: float) -> None:
        """Send on the present connection, whole or not at all as far as the peer can tell; connects if nothing has yet.

        Nothing is kept for later: what cannot be sent now is not sent. Where the peer takes only a part of it in time,
        the connection is given up, since whatever followed would be read as its rest.

        Raises:
            ConnectionLost: there is no connection at present.
            LinkTimeout: the peer did not take it within `timeout` seconds.
            RemoteError: the first connection could not be made.
            LocalError: the stream is a recording, or was closed.
        """
        self.start()
        with self._sending:
            if self._connection is not ConnectionState.CONNECTED:
                raise self._not_connected()
            try:
                self._transport.send(data, timeout)
            except LinkTimeout:
                self._transport.abort()
                raise

    def _send_some(self, data: bytes | memoryview) -> int:
        """Hand to the kernel what it takes at once; its number of bytes. Neither waits nor takes a lock.

        Raises:
            ConnectionLost: there is no connection at present.
            Closed: the stream was closed.
        """
        if self._connection is not ConnectionState.CONNECTED:
            raise self._not_connected()
        return self._transport.send_some(data)

    def _wait_for_room(self, timeout: float) -> bool:
        """Wait until something can be sent; False when time is up."""
        return self._transport.wait_for_room(timeout)

    def _reads_here(self) -> bool:
        """The current thread is the one that reads."""
        return threading.current_thread() is self._reader

    def _abort(self) -> None:
        """Give up what was sent: discard what the peer has not acknowledged, and connect again."""
        self._transport.abort()

    def _not_connected(self) -> Exception:
        if self._closing.is_set() or self._over:
            return Closed(f"{self.name} was closed, or is over")
        because = f": {self._error}" if self._error is not None else ""
        return ConnectionLost(f"{self.name} is not connected{because}")

    def join(self, timeout: float | None = None) -> bool:
        """Wait until a recording is over and all of it is delivered; False when time is up."""
        until = None if timeout is None else time.monotonic() + timeout

        def left() -> float | None:
            return None if until is None else max(until - time.monotonic(), 0.0)

        reader = self._reader
        if reader is not None:
            reader.join(left())
            if reader.is_alive():
                return False
        return all(subscription.join(left()) for subscription in self._distribution.subscriptions)

    def close(self, timeout: float = 2.0) -> None:
        """Disconnect and end every subscription and iteration; within `timeout` seconds.

        What waits is dropped and counted, but under the policy `block` it is still delivered, if need
        be after this has returned. A callback that is running then is left to end by itself. Only a
        reader that is still kept when time is up, by a full queue or a callback, makes `block` drop
        too. Idempotent; may be called from a callback.
        """
        until = time.monotonic() + timeout
        self._closing.set()
        self._transport.close()
        distribution, reader = self._distribution, self._reader
        subscriptions = distribution.subscriptions
        distribution.close_evicting()
        while reader is not None and reader is not threading.current_thread():
            reader.join(max(until - time.monotonic(), 0.0))
            if reader is self._reader or self._reader is None:
                break
            reader = self._reader  # another thread has taken over meanwhile
        for subscription in subscriptions:
            subscription.join(until - time.monotonic())
        if reader is not None and reader.is_alive():
            distribution.close_all()
        self._connection = ConnectionState.CLOSED
        self._settled.set()

    # -- what feeds use ------------------------------------------------------------------------

    def start(self) -> None:
        """Connect, if nothing has yet, and wait until it is done.

        Raises:
            RemoteError: the connection could not be made; the next use tries again.
            Closed: the stream was closed.
        """
        self._start(patient=False)
        if not self._settled.wait(self._timeout + 1.0):
            raise self._error or LinkTimeout(f"{self.name}: no connection within {self._timeout:g} s")
        if not self._opened and self.failure is not None:
            raise self.failure

    def start_quietly(self) -> None:
        """Begin to connect, if nothing has yet, without waiting; failures are retried by the backoff."""
        if not self._closing.is_set():
            self._start(patient=True)

    def _start(self, patient: bool) -> None:
        with self._lock:
            if self._closing.is_set():
                raise Closed(f"{self.name} was closed")
            if self._reader is None:
                self.failure = self._error = None
                self._patient = patient
                self._opened = False
                self._settled.clear()
                self._reader = threading.Thread(target=self._read, name=f"{self.name} reader", daemon=True)
                self._reader.start()

    def default_policy(self, kind: type, for_states: Policy) -> Policy:
        """The policy of those who do not say: events are kept, states are replaced by newer ones."""
        if self._lossless:
            return block
        return drop_oldest(1024) if getattr(kind, "IS_EVENT", kind is ConnectionEvent) else for_states

    def newest(self, kind: type[K]) -> K | None:
        """The newest packet of class `kind` on the present connection."""
        return self._distribution.newest(kind)

    def expand(self, kind: type[K], packet: Any) -> Iterable[K]:
        """What of class `kind` a packet is or holds."""
        return self._distribution.expand(kind, packet)

    def open_inbox(self, kind: type, policy: Policy, counts: bool = True) -> Inbox:
        """A queue of packets that are or hold a `kind`; see `close_inbox`.

        Without `counts`, what it drops was not missed by anybody: the stream does not count it.
        """
        inbox = self._distribution.add_inbox(kind, policy, counts)
        try:
            self.start()
        except Exception:
            self.close_inbox(inbox)
            raise
        if self._closing.is_set() or self._over:
            inbox.end()
        return inbox

    def close_inbox(self, inbox: Inbox) -> None:
        """Take a queue away; what waits in it is dropped and counted."""
        self._distribution.remove_inbox(inbox)
        inbox.close()

    def open_subscription(
        self,
        kind: type,
        callback: Callable[[Any], object],
        *,
        policy: Policy,
        deadline: float | None = None,
        on_deadline: Callable[[float], object] | None = None,
        linger: float = 0.0,
    ) -> Subscription:
        """A callback on a queue of its own.

        With `linger`, packets gather for so many seconds before they are handed over: it spares the
        reader waking the other thread for each.
        """
        inbox = self.open_inbox(kind, policy)
        name = f"{self.name} {kind.__name__}"
        return self._distribution.add_subscription(name, kind, callback, inbox, deadline, on_deadline, linger)

    def why_nothing(self, kind: type, timeout: float) -> Exception:
        """What to raise when no packet of class `kind` came within `timeout` seconds."""
        if self.failure is not None:
            return self.failure
        if self._closing.is_set() or self._over:
            return Closed(f"{self.name} was closed, or is over")
        because = ""
        if self._connection is not ConnectionState.CONNECTED and self._error is not None:
            because = f"; it is not connected: {self._error}"
        return LinkTimeout(f"no {kind.__name__} from {self.name} within {timeout:g} s{because}")

    # -- the reader thread ---------------------------------------------------------------------

    def _read_on(self) -> None:
        """Go on reading in place of a reader that a callback keeps."""
        with self._lock:
            self._reader = threading.current_thread()
        self._read(connected=True)

    def _read(self, connected: bool = False) -> None:
        waits = self._backoff.waits()
        failure: Exception | None = None
        while not self._closing.is_set():
            error: Exception | None = None
            before = self._tally.received
            try:
                if not connected:
                    self._tell(ConnectionState.CONNECTING)
                    self._transport.open(self._timeout)
                    if self._closing.is_set():  # closed while connecting: it could not see this socket
                        break
                    self._connected()
                connected = False
                self._pump()
            except Relieved:
                return
            except Finished:
                break
            except WrongPeer as raised:
                error = raised
                if not self._tally.received:  # it never was the right one: trying again would not help
                    failure = raised
                    self._disconnected(raised)
                    break
            except RemoteError as raised:
                error = raised
            except Exception as raised:
                _log.exception("%s: the reader failed", self.name)
                failure = raised
                break
            self._disconnected(error)
            if self._closing.is_set():
                break
            self._error = error
            if not self._opened and not self._patient:
                failure = error
                break
            if self._tally.received > before:
                waits = self._backoff.waits()  # reset by success: by packets, not by a mere connection
            wait = next(waits, None)
            if wait is None:
                failure = error
                break
            self._closing.wait(wait)
        self._finish(failure)

    def _connected(self) -> None:
        self._session = self._session_factory()
        self._tally.connected()
        self._opened = True
        self._tell(ConnectionState.CONNECTED)
        self._settled.set()

    def _disconnected(self, error: Exception | None) -> None:
        self._transport.abort()
        self._distribution.forget()
        session, self._session = self._session, None
        if session is not None:
            self._tally.disconnected(session)
        if not self._closing.is_set():
            _log.info("%s: connection lost: %s", self.name, error)
        self._tell(ConnectionState.LOST, error)

    def _finish(self, failure: Exception | None) -> None:
        self._transport.abort()
        if failure is not None or self._closing.is_set():
            self._distribution.forget()  # the last of a recording stays: it is no older than the others
        with self._lock:
            self.failure = failure
            if failure is not None:
                self._reader = None  # the next use tries again
            else:
                self._over = True
        if failure is not None and self._opened:
            _log.warning("%s: given up: %s", self.name, failure)  # whoever only has a callback learns it here
        self._tell(ConnectionState.IDLE if failure is not None else ConnectionState.CLOSED, failure)
        self._settled.set()
        self._distribution.end()

    def _pump(self) -> None:
        """Read until the transport raises."""
        session, transport, silence = self._session, self._transport, self._silence
        assert session is not None
        framer, distribution, tally = session.framer, self._distribution, self._tally
        progress = time.monotonic()
        while True:
            data, stamp = transport.receive()
            if distribution.taps:
                distribution.tap(data, framer.rest, stamp)
            frames = framer.feed(data)
            if frames:
                progress = stamp.monotonic
            elif silence is not None and time.monotonic() - progress > silence:
                raise LinkTimeout(f"{self.name}: bytes come, but no packet for {silence:g} s")
            packets, failures = session.decode_all(frames, stamp)
            for error in failures:
                self._report(error)
            tally.count(len(packets), len(failures), len(data), stamp)
            if packets:
                distribution.publish(packets)

    def _report(self, error: PacketError) -> None:
        failed = self._tally.failed + 1
        if failed & (failed - 1) == 0:  # each power of two: bad packets at 500 Hz must not fill the disk
            _log.warning("%s: bad packet, %d so far: %s", self.name, failed, error)

    def _tell(self, state: ConnectionState, error: Exception | None = None) -> None:
        self._connection = state
        self._distribution.tell(ConnectionEvent(state, self.name, error, Stamp.now()))

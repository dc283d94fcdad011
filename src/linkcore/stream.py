"""From the socket to the subscribers: the reader thread, and everything that hangs on it.

    transport -> framer -> decoder -> inboxes -> callbacks
    [----------- reader thread -----------]   [own threads]

A `Stream` reconnects by itself and keeps its subscriptions meanwhile. What it hands out is typed:
`Stream.of` gives the same stream seen as the packets of one class.
"""

from __future__ import annotations

import enum
import logging
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, Generic, NamedTuple, Protocol, TypeVar

from .backoff import Backoff
from .errors import BadValue, Closed, LinkTimeout, PacketError, RemoteError, WrongPeer
from .framing import Framer
from .inbox import Inbox
from .packet import State
from .policy import Policy, block, drop_oldest, latest
from .shortcut import Relieved, Shortcut
from .stamp import Stamp
from .statistics import StreamStatistics
from .subscription import Subscription
from .transport import Finished, Transport

__all__ = ["Chunk", "ConnectionEvent", "ConnectionState", "Feed", "Session", "Stream", "Traffic"]

_log = logging.getLogger(__name__)

# A NamedTuple made without its own __new__, which is written in Python.
_new = tuple.__new__

T = TypeVar("T")
K = TypeVar("K")


class ConnectionState(enum.Enum):
    """What a stream's connection is doing."""

    IDLE = "idle"
    CONNECTING = "connecting"
    CONNECTED = "connected"
    LOST = "lost"
    CLOSED = "closed"


class ConnectionEvent(NamedTuple):
    """A change of a stream's connection; subscribe to it as to a packet.

    Attributes:
        state: the new state.
        stream: name of the stream.
        error: what ended the connection, or None.
        received: when it was noticed.
    """

    state: ConnectionState
    stream: str
    error: Exception | None
    received: Stamp


class Traffic:
    """Everything as it came: subscribe to it for each `Chunk` and each `ConnectionEvent`, in order."""

    IS_EVENT = True


class Chunk(NamedTuple):
    """Bytes as they came, and when."""

    data: bytes
    received: Stamp


class Session(Protocol):
    """One connection's protocol, sans-IO; a stream makes a new one each time it connects."""

    framer: Framer

    @property
    def unknown(self) -> int:
        """Packets, or parts of one, of a type that no layout is known for."""

    @property
    def tails(self) -> int:
        """Packets, or parts of one, that end in bytes which no known layout explains."""

    def decode(self, frame: bytes, stamp: Stamp | None = None) -> Any:
        """The typed packet in one frame; raises `PacketError`."""

    def decode_all(self, frames: Sequence[bytes], stamp: Stamp | None = None) -> Sequence[Any]:
        """The typed packets in many frames; raises `PacketError` if one of them is bad."""


class Feed(Generic[T]):
    """The packets of one class on a stream: iterate, subscribe, look at the newest, wait for the next."""

    def __init__(self, stream: Stream[Any], kind: type[T]) -> None:
        self._stream = stream
        self._kind = kind

    @property
    def latest(self) -> T | None:
        """The newest packet of this connection, or None. Never blocks.

        None before the first packet came and again as soon as the connection is lost: old data is
        never shown as new. A recording that is over keeps its last one. Begins to connect, if
        nothing has yet.
        """
        self._stream.start_quietly()
        newest: T | None = self._stream.newest(self._kind)
        return newest

    def wait(self, timeout: float = 5.0) -> T:
        """The next packet that arrives.

        Raises:
            LinkTimeout: none came within `timeout` seconds.
            RemoteError: the first connection could not be made, or the stream gave up.
            Closed: the stream was closed.
        """
        inbox = self._stream.open_inbox(self._kind, latest, counts=False)
        try:
            packet = inbox.next(timeout)
            if packet is not None:
                first: T = next(iter(self._stream.expand(self._kind, packet)))
                return first
        finally:
            self._stream.close_inbox(inbox)
        raise self._stream.why_nothing(self._kind, timeout)

    def iterate(self, policy: Policy | None = None, timeout: float | None = None) -> Iterator[T]:
        """Iterate with a policy or a timeout of your own; a plain ``for`` keeps the newest state, or 1024 events.

        Ends when the stream is closed, or a recording is over. Without a timeout it waits for as
        long as the backoff allows for a robot that went away; `ConnectionEvent` tells of that.

        Raises:
            LinkTimeout: nothing came within `timeout` seconds.
            RemoteError: the first connection could not be made, or the stream gave up.
        """
        stream = self._stream
        inbox = stream.open_inbox(self._kind, policy or stream.default_policy(self._kind, latest))
        try:
            while True:
                packet = inbox.next(timeout)
                if packet is not None:
                    yield from stream.expand(self._kind, packet)
                elif inbox.is_over:
                    break
                elif timeout is not None:
                    raise stream.why_nothing(self._kind, timeout)
        finally:
            stream.close_inbox(inbox)
        if stream.failure is not None:
            raise stream.failure

    def __iter__(self) -> Iterator[T]:
        return self.iterate()

    def subscribe(
        self,
        callback: Callable[[T], object],
        *,
        policy: Policy | None = None,
        deadline: float | None = None,
        on_deadline: Callable[[float], object] | None = None,
    ) -> Subscription:
        """Call `callback` with each packet, in a thread of its own, until closed.

        Args:
            callback: may be slow and may raise; neither harms anybody else.
            policy: what to do when it falls behind: `latest`, `drop_oldest(n)` or `block`; by
                default `drop_oldest(256)`, and 1024 for events.
            deadline: seconds within which a packet has to come.
            on_deadline: called with the seconds since the last packet, once for each silence that
                lasts longer than `deadline`; by default the log gets a warning.

        Raises:
            RemoteError: the first connection could not be made.
            Closed: the stream was closed.
        """
        if deadline is not None and not deadline > 0:
            raise BadValue(f"deadline is {deadline}; expected a positive number of seconds")
        if on_deadline is not None and deadline is None:
            raise BadValue("on_deadline was given without a deadline")
        return self._stream.open_subscription(
            self._kind,
            callback,
            policy=policy or self._stream.default_policy(self._kind, drop_oldest(256)),
            deadline=deadline,
            on_deadline=on_deadline,
        )


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
        session: Callable[[], Session],
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
        self._session: Session | None = None
        self._parts = parts
        self._backoff = backoff or Backoff()
        self._timeout = timeout
        self._silence = silence
        self._lossless = lossless
        self._lock = threading.Lock()
        self._closing = threading.Event()
        self._opened = False
        self._over = False
        self._patient = False
        self._error: Exception | None = None
        self._settled = threading.Event()  # the first connection was made, or could not be
        self._reader: threading.Thread | None = None
        self._connection = ConnectionState.IDLE
        # Who gets packets (object), connection events, and everything as it came. Replaced, never changed.
        self._inboxes: dict[type, tuple[Inbox, ...]] = {object: (), ConnectionEvent: (), Traffic: ()}
        self._subscriptions: list[Subscription] = []
        self._shortcut: Shortcut | None = None
        # Where packets go: the inboxes, and last of all the shortcut in place of its own.
        self._outlets: tuple[Inbox | Shortcut, ...] = ()
        self._taps: tuple[Inbox, ...] = ()
        self._newest: dict[type, Any] = {}
        self._received = self._dropped = self._failed = 0
        self._bytes = self._connections = self._skipped = self._resyncs = self._unknown = self._tails = 0
        self._arrived: float | None = None
        self._window = (time.monotonic(), 0)
        self._rate = 0.0

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
    def session(self) -> Session | None:
        """The protocol of the present connection, or None."""
        return self._session

    @property
    def stats(self) -> StreamStatistics:
        """The counters at this moment."""
        now = time.monotonic()
        # Each is read once, what is part of another one first: they add up whatever the reader does meanwhile.
        dropped, failed = self._dropped, self._failed
        received = self._received
        (since, count), rate, session = self._window, self._rate, self._session
        elapsed = now - since
        if elapsed > 2.0 or (not rate and elapsed > 0.5):
            rate = (received - count) / elapsed  # the last whole window is too old, or there was none
        return StreamStatistics(
            received=received,
            delivered=received - dropped - failed,
            dropped=dropped,
            failed=failed,
            reconnects=max(self._connections - 1, 0),
            rate=rate,
            bytes=self._bytes,
            skipped=self._skipped + (session.framer.skipped if session is not None else 0),
            resyncs=self._resyncs + (session.framer.resyncs if session is not None else 0),
            unknown=self._unknown + (session.unknown if session is not None else 0),
            tails=self._tails + (session.tails if session is not None else 0),
            age=None if self._arrived is None else now - self._arrived,
        )

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
        with self._lock:
            subscriptions = list(self._subscriptions)
        return all(subscription.join(left()) for subscription in subscriptions)

    def close(self, timeout: float = 2.0) -> None:
        """Disconnect and end every subscription and iteration; within `timeout` seconds.

        What waits is dropped and counted, but under the policy `block` it is still delivered, if need
        be after this has returned. A callback that is running then is left to end by itself. Only a
        reader that still waits for room when time is up makes `block` drop too. Idempotent; may be
        called from a callback.
        """
        until = time.monotonic() + timeout
        self._closing.set()
        self._transport.close()
        reader, here = self._reader, threading.current_thread()
        with self._lock:
            if self._shortcut is not None:
                self._shortcut.end()
            inboxes = [inbox for group in self._inboxes.values() for inbox in group]
            subscriptions = list(self._subscriptions)
        callers = [each.inbox for each in subscriptions if each.runs_in(threading.get_ident())]
        for inbox in inboxes:
            # The caller's own queue will not be emptied while it waits here.
            if inbox.evicts or inbox in callers:
                inbox.close()
        if reader is not None and reader is not here:
            reader.join(max(until - time.monotonic(), 0.0))
        for subscription in subscriptions:
            subscription.join(until - time.monotonic())
        if reader is not None and reader.is_alive():
            for inbox in inboxes:
                inbox.close()
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

    def open_inbox(self, kind: type, policy: Policy, counts: bool = True) -> Inbox:
        """A queue of packets that are or hold a `kind`; see `close_inbox`.

        Without `counts`, what it drops was not missed by anybody: the stream does not count it.
        """
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
        try:
            self.start()
        except Exception:
            self.close_inbox(inbox)
            raise
        if self._closing.is_set() or self._over:
            inbox.end()
        return inbox

    def detach_inbox(self, inbox: Inbox) -> None:
        """Give a queue no more; what waits in it can still be taken."""
        with self._lock:
            for group, inboxes in list(self._inboxes.items()):
                self._inboxes[group] = tuple(each for each in inboxes if each is not inbox)
            if self._shortcut is not None and self._shortcut.inbox is inbox:
                self._shortcut.end()
                self._shortcut = None
            self._route()

    def close_inbox(self, inbox: Inbox) -> None:
        """Take a queue away; what waits in it is dropped and counted."""
        self.detach_inbox(inbox)
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
        whole = kind is self._kind or kind in (Traffic, ConnectionEvent)

        def detach(subscription: Subscription) -> None:
            self.detach_inbox(subscription.inbox)
            with self._lock:
                self._subscriptions = [each for each in self._subscriptions if each is not subscription]

        subscription = Subscription(
            inbox,
            callback,
            name=f"{self.name} {kind.__name__}",
            expand=None if whole else lambda packet: self.expand(kind, packet),
            deadline=deadline,
            on_deadline=on_deadline,
            linger=linger,
            detach=detach,
            trust=self._trust if kind is self._kind and self._parts is None else None,
        )
        with self._lock:
            self._subscriptions.append(subscription)
        return subscription

    def _route(self) -> None:
        """Say anew where packets go; with the lock."""
        self._taps = self._inboxes[Traffic]
        inboxes, shortcut = self._inboxes[object], self._shortcut
        others = inboxes if shortcut is None else [inbox for inbox in inboxes if inbox is not shortcut.inbox]
        self._outlets = (*others, *([] if shortcut is None else [shortcut]))

    def _trust(self, subscription: Subscription) -> None:
        """Let the reader call this subscription back itself, if it does so for no other."""
        with self._lock:
            is_here = any(inbox is subscription.inbox for inbox in self._inboxes[object])
            if self._shortcut is None and is_here and not self._closing.is_set():
                self._shortcut = Shortcut(subscription, self._withdraw, self._read_on)
                self._route()

    def _withdraw(self, shortcut: Shortcut) -> None:
        """Send a subscription that was slow back to its own thread."""
        with self._lock:
            if self._shortcut is shortcut:
                self._shortcut = None
                self._route()
        shortcut.end()
        shortcut.subscription.distrust()

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
        self._reader = threading.current_thread()
        self._read(connected=True)

    def _read(self, connected: bool = False) -> None:
        waits = self._backoff.waits()
        failure: Exception | None = None
        while not self._closing.is_set():
            error: Exception | None = None
            before = self._received
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
                if not self._received:  # it never was the right one: trying again would not help
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
            if self._received > before:
                waits = self._backoff.waits()  # reset by success: by packets, not by a mere connection
            wait = next(waits, None)
            if wait is None:
                failure = error
                break
            self._closing.wait(wait)
        self._finish(failure)

    def _connected(self) -> None:
        with self._lock:
            self._session = self._session_factory()
            self._connections += 1
            self._opened = True
            self._window = (time.monotonic(), self._received)
            self._rate = 0.0
        self._tell(ConnectionState.CONNECTED)
        self._settled.set()

    def _disconnected(self, error: Exception | None) -> None:
        self._transport.close()
        with self._lock:
            self._newest = {}
            if self._session is not None:
                self._skipped += self._session.framer.skipped + len(self._session.framer.rest)
                self._resyncs += self._session.framer.resyncs
                self._unknown += self._session.unknown
                self._tails += self._session.tails
            self._session = None
        if not self._closing.is_set():
            _log.info("%s: connection lost: %s", self.name, error)
        self._tell(ConnectionState.LOST, error)

    def _finish(self, failure: Exception | None) -> None:
        self._transport.close()
        with self._lock:
            if failure is not None or self._closing.is_set():
                self._newest = {}  # the last of a recording stays: it is no older than the others
            self.failure = failure
            if failure is not None:
                self._reader = None  # the next use tries again
            else:
                self._over = True
            inboxes = [inbox for group in self._inboxes.values() for inbox in group]
            if self._shortcut is not None:
                self._shortcut.end()
        self._tell(ConnectionState.IDLE if failure is not None else ConnectionState.CLOSED, failure)
        self._settled.set()
        for inbox in inboxes:
            inbox.end()

    def _pump(self) -> None:
        """Read until the transport raises."""
        session, transport, silence = self._session, self._transport, self._silence
        assert session is not None
        feed, receive = session.framer.feed, transport.receive
        progress = time.monotonic()
        while True:
            data, stamp = receive()
            for inbox in self._taps:
                if not inbox.received and session.framer.rest:
                    inbox.put(Chunk(session.framer.rest, stamp))  # the head of the packet it came into
                inbox.put(_new(Chunk, (data, stamp)))
            frames = feed(data)
            if frames:
                progress = stamp.monotonic
            elif silence is not None and time.monotonic() - progress > silence:
                raise LinkTimeout(f"{self.name}: bytes come, but no packet for {silence:g} s")
            failed = 0
            try:
                packets: Sequence[Any] = (
                    session.decode_all(frames, stamp) if len(frames) != 1 else [session.decode(frames[0], stamp)]
                )
            except PacketError:
                packets, failed = self._decode_singly(session, frames, stamp)
            self._publish(packets, failed, len(data), stamp)

    def _decode_singly(self, session: Session, frames: list[bytes], stamp: Stamp) -> tuple[list[Any], int]:
        """All that can be decoded, and how many cannot: one bad packet takes no other with it."""
        packets = []
        for frame in frames:
            try:
                packets.append(session.decode(frame, stamp))
            except PacketError as error:
                self._report(error)
        return packets, len(frames) - len(packets)

    def _publish(self, packets: Sequence[Any], failed: int, size: int, stamp: Stamp) -> None:
        # Only the reader writes these, so they need no lock.
        self._bytes += size
        self._failed += failed
        self._received += len(packets) + failed
        since, before = self._window
        arrived = stamp[0]
        if arrived - since >= 1.0:
            self._rate = (self._received - before) / (arrived - since)
            self._window = (arrived, self._received)
        if not packets:
            return
        self._arrived = arrived
        if self._parts is None:
            self._newest[self._kind] = packets[-1]
        else:
            for packet in packets:
                self._remember(packet)
                for part in self._parts(packet):
                    self._remember(part)
        for outlet in self._outlets:
            outlet.offer(packets)

    def _remember(self, packet: Any) -> None:
        # Taken out first, so that the newest stands last.
        self._newest.pop(type(packet), None)
        self._newest[type(packet)] = packet

    def _lose(self, packet: Any) -> None:
        """A subscription drops a packet: counted once, however many do."""
        with self._lock:
            try:
                packet._lost  # noqa: B018
            except AttributeError:
                packet._lost = True
                self._dropped += 1

    def _report(self, error: PacketError) -> None:
        failed = self._failed + 1
        if failed & (failed - 1) == 0:  # each power of two: bad packets at 500 Hz must not fill the disk
            _log.warning("%s: bad packet, %d so far: %s", self.name, failed, error)

    def _tell(self, state: ConnectionState, error: Exception | None = None) -> None:
        self._connection = state
        event = ConnectionEvent(state, self.name, error, Stamp.now())
        for group in (ConnectionEvent, Traffic):
            for inbox in self._inboxes[group]:
                inbox.offer((event,))

"""Selector loop, which serves many TCP clients in one thread and never waits for a single client.

A server of this project (the simulated controller, the RHD host) is a `SelectorLoop`. It has a `ListeningPort` for each
TCP port, and a `Handler` for each connection. The handler uses no sockets (sans-IO): it gets bytes, and sends its
answers with `Connection.write`. The thread that owns the loop calls `serve_once` between two of its own deadlines, such
as the cycles of a controller::

    loop = SelectorLoop()
    loop.listen("127.0.0.1", 0, accept)            # accept(connection) -> Handler
    while not is_closing:
        do_what_is_due()
        loop.serve_once(until=next_deadline)
    loop.close()

Only this thread may use the loop. The exceptions are `wake`, `call`, and reading the counters.

A client can affect other clients only within limits:

- Each poll of the sockets reads one chunk from each client.
- Output that a client does not read is buffered up to `output_limit` bytes. Then the connection is reset.
- A port has a maximum number of clients, and gives the slot of an idle client to a new one.
- A connection can have a deadline, after which it is reset.
"""

from __future__ import annotations

import contextlib
import errno
import logging
import math
import os
import select
import selectors
import socket
import struct
import threading
import weakref
from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import Future

from .. import clock
from ..deferred import Deferred, SteadyBytes
from ..errors import BadAddress, LinkTimeout
from .listener import bound_socket, numeric_host

_log = logging.getLogger(__name__)

#: Default maximum number of clients of one port.
MOST_CLIENTS = 100
#: Seconds without a sent or accepted byte after which the slot of a client may be given to a new client.
IDLE = 60.0
#: Maximum number of bytes that are buffered for one client, in addition to the kernel's buffer.
OUTPUT_LIMIT = 1 << 20
#: Maximum number of bytes that are read from one client at a time.
CHUNK = 1 << 16

# Maximum number of connections that wait in the kernel; maximum number of connections that are accepted in one poll.
_BACKLOG, _ACCEPTS = 64, 16
# Size of the kernel's buffer for a client, in bytes. By default, this buffer grows to megabytes, which hold seconds of
# old data.
_KERNEL_BUFFER = 1 << 18
# Minimum time in s for serving events, even if the owner of the loop is already late. Without it, clients might never
# be served.
_LEAST_SLICE = 1e-3
# Pause in s after the process ran out of descriptors. Without the pause, the kernel would immediately report the same
# waiting client again.
_OUT_OF_DESCRIPTORS = 0.2
_EXHAUSTED = {errno.EMFILE, errno.ENFILE, errno.ENOBUFS, errno.ENOMEM}
# `select` accepts only descriptors below this number.
_SELECTABLE = 1024
# Closing a socket with this option resets the connection, and discards the data in the kernel.
_ABORT = struct.pack("ii", 1, 0)
_NEVER = math.inf


class Handler:
    """Handler of the bytes of one connection. The thread that owns the loop calls its methods.

    An exception in a method is logged with its traceback, and ends only this connection.
    """

    @property
    def is_busy(self) -> bool:
        """Whether the client keeps its slot although no bytes are transferred, because it waits for this server."""
        return False

    def data_received(self, data: bytes) -> None:
        """Process received bytes. The handler must find the boundaries of frames itself."""

    def drained(self) -> None:
        """Handle the end of buffering: the kernel has now accepted all written data."""

    def connection_lost(self, reason: str, *, by_peer: bool) -> None:
        """Handle the end of the connection. No other method is called after this one.

        Args:
            reason: Reason, for a log.
            by_peer: Whether the peer, and not this side, has closed or reset the connection.
        """


class Connection:
    """Connection of one client, for its handler.

    Attributes:
        port: Port to which the client has connected.
        peer: (numeric host, port) of the client.
        handler: Handler of the received bytes.
        last_activity: Time on the loop's clock of the last sent or received byte.
    """

    def __init__(self, loop: SelectorLoop, port: ListeningPort, link: socket.socket, peer: tuple[str, int]) -> None:
        self.port = port
        self.peer = peer
        self.handler = Handler()
        self.last_activity = loop.time()
        self._loop = loop
        self._socket = link
        # Only a simulated socket can send packets whose bytes are not made yet.
        self._sends_deferred = hasattr(link, "recv_deferred")
        self._pending = bytearray()
        self._is_open = True
        self._is_reading = True
        self._is_finishing = False
        self._is_deaf = False
        self._mask = 0
        self._deadline = _NEVER
        self._deadline_reason = ""

    @property
    def name(self) -> str:
        """Address host:port of the client, used in messages."""
        host, port = self.peer
        return f"[{host}]:{port}" if ":" in host else f"{host}:{port}"

    @property
    def is_open(self) -> bool:
        """Whether the client is connected, and neither `close` nor `finish` was called."""
        return self._is_open and not self._is_finishing

    @property
    def pending(self) -> int:
        """Number of written bytes that the kernel has not accepted yet."""
        return len(self._pending)

    # -- output --------------------------------------------------------------------------------------

    def write(self, data: bytes | Deferred) -> None:
        """Send `data`: as much as the kernel accepts now, and the rest later.

        This has no effect on a closed connection. If the client does not read, so that more than the `output_limit` of
        the port would be buffered, the connection is reset.
        """
        if not self.is_open or self._is_deaf:
            return
        if not (self._sends_deferred and not self._pending):
            data = bytes(data)
        if not self._pending:
            sent = self._send(data)
            if sent == len(data) or self._is_deaf:
                return
            data = bytes(data)[sent:]
        self._pending += data  # type: ignore[arg-type]  # these are bytes
        if len(self._pending) > self.port.output_limit:
            self.port.overflowed += 1
            self._loop._drop(self, f"did not read: {len(self._pending)} bytes are buffered for it", reset=True)
        else:
            self._watch()

    @property
    def _is_direct(self) -> bool:
        """Whether the next data goes directly to a simulated socket, because no earlier data waits."""
        return self._sends_deferred and not self._pending and self.is_open and not self._is_deaf

    def write_steady(self, packet: Deferred | SteadyBytes) -> bool:
        """Send a steady packet, and let simulated time pass until it arrives.

        Return False, and send nothing, if something else could happen before that, and always in real time.
        """
        if not self._is_direct or not self._socket.send_steady(packet):  # type: ignore[attr-defined]  # it is a simulated socket
            return False
        self.last_activity = self._loop.looked_at
        return True

    @property
    def quiet_time(self) -> float:
        """Time in s for which `write_batch` may send packets at once; always 0 in real time."""
        if not self._is_direct:
            return 0.0
        seconds: float = self._socket.quiet_time  # type: ignore[attr-defined]  # it is a simulated socket
        return seconds

    def write_batch(self, packets: Sequence[Deferred | SteadyBytes], delays: Sequence[float]) -> None:
        """Send steady packets, each after a delay in s from now. `quiet_time` limits the delays."""
        self._socket.send_batch(packets, delays)  # type: ignore[attr-defined]
        self.last_activity = self._loop.time()

    def _send(self, data: bytes | bytearray | Deferred) -> int:
        try:
            sent = self._socket.send(data)  # type: ignore[arg-type]  # only a simulated socket gets a deferred packet
        except BlockingIOError:
            return 0
        except OSError:
            # The peer accepts no more data, but its earlier data might still be unread. For example, a client might
            # send a command and close without reading. The connection ends when this data has been read.
            self._is_deaf = True
            self._pending.clear()
            self._watch()
            return 0
        self.last_activity = self._loop.time()
        return sent

    def _flush(self) -> None:
        sent = self._send(self._pending)
        if not sent:
            return
        del self._pending[:sent]
        if self._pending:
            return
        self._watch()
        if self._is_finishing:
            self._end_output()
        else:
            self._loop._guard(self, self.handler.drained)

    # -- input ---------------------------------------------------------------------------------------

    def pause_reading(self) -> None:
        """Stop reading from the client, which then has to wait (back-pressure), until `resume_reading`."""
        self._is_reading = False
        self._watch()

    def resume_reading(self) -> None:
        """Continue to read from the client."""
        self._is_reading = True
        self._watch()

    def _receive(self) -> None:
        try:
            data = self._socket.recv(self.port.chunk)
        except BlockingIOError:
            return
        except OSError as error:
            self._loop._drop(self, error.strerror or str(error), by_peer=True)
            return
        if not data:
            self._loop._drop(self, "closed by the peer", by_peer=True)
            return
        self.last_activity = self._loop.time()
        if not self._is_finishing:
            self._loop._guard(self, self.handler.data_received, data)

    # -- deadline and end ------------------------------------------------------------------------------

    def set_deadline(self, when: float, reason: str) -> None:
        """Reset the connection at a time on the loop's clock, unless the deadline is changed or cleared before.

        Args:
            when: Absolute time. See `SelectorLoop.time`.
            reason: Reason for `Handler.connection_lost`: the action that the client failed to do in time.
        """
        self._deadline, self._deadline_reason = when, reason
        self._loop._is_due_at(when)

    def clear_deadline(self) -> None:
        """Remove the deadline, because the client has met it."""
        self._deadline = _NEVER

    def close(self, *, reset: bool = False, reason: str = "closed by this side") -> None:
        """End the connection now.

        Buffered data is discarded, except for the data in the kernel. Idempotent.

        Args:
            reset: Whether to discard the data in the kernel too. The client then sees a reset rather than an end.
            reason: Reason for `Handler.connection_lost`.
        """
        self._loop._drop(self, reason, reset=reset)

    def finish(self, within: float) -> None:
        """End the connection in order: send buffered data, and wait until the client closes too.

        All of this takes at most `within` seconds. Data that the client sends meanwhile is discarded. Closing at once
        while bytes of the client are unread would reset the connection, and the client could lose the last reply.
        """
        if not self.is_open:
            return
        self._is_finishing = True
        self._is_reading = True
        self.set_deadline(self._loop.time() + within, "closed by this side")
        if self._pending:
            self._watch()
        else:
            self._end_output()

    def _end_output(self) -> None:
        try:
            self._socket.shutdown(socket.SHUT_WR)
        except OSError as error:
            self._loop._drop(self, error.strerror or str(error), by_peer=True)

    def _watch(self) -> None:
        """Register at the selector for the next possible events of this connection."""
        if not self._is_open:
            return
        mask = (selectors.EVENT_READ if self._is_reading else 0) | (selectors.EVENT_WRITE if self._pending else 0)
        if mask != self._mask:
            self._loop._register(self._socket, self._mask, mask, self)
            self._mask = mask


class ListeningPort:
    """TCP port of a server with its connected clients, returned by `SelectorLoop.listen`.

    Attributes:
        number: Number of the port.
        is_listening: Whether clients can connect. If not, the number is kept, and the kernel refuses connections.
        connections: Current clients.
        output_limit: Maximum number of bytes that are buffered for one client.
        chunk: Maximum number of bytes that are read from one client at a time.
        accepted: Number of accepted connections so far.
        refused: Number of connections that were closed at once, because all slots were taken, or `accept` returned
            None.
        evicted: Number of idle clients whose slot was given to a new client.
        overflowed: Number of clients that were reset because they did not read.
    """

    def __init__(
        self,
        loop: SelectorLoop,
        host: str,
        number: int,
        accept: Callable[[Connection], Handler | None],
        *,
        purpose: str,
        limit: int,
        idle: float,
        output_limit: int,
        chunk: int,
    ) -> None:
        self.output_limit = output_limit
        self.chunk = chunk
        self.connections: set[Connection] = set()
        self.accepted = self.refused = self.evicted = self.overflowed = 0
        self._loop = loop
        self._host = host
        self._accept = accept
        self._purpose = purpose
        self._limit = limit
        self._idle = idle
        self._socket = bound_socket(host, number, purpose=purpose)
        self.number: int = self._socket.getsockname()[1]
        self.is_listening = False
        self._is_accepting = True
        self._is_watched = False
        self._retry_at = _NEVER

    def listen(self) -> None:
        """Let clients connect.

        Raises:
            BadAddress: If another socket that was bound to the same number already listens.
        """
        if self.is_listening:
            return
        try:
            self._socket.listen(_BACKLOG)
        except OSError as error:
            where = f"{self._host or '*'}:{self.number}" + (f" for {self._purpose}" if self._purpose else "")
            raise BadAddress(f"cannot listen on {where}: {error.strerror}") from error
        self.is_listening = True
        self._watch()

    def refuse(self) -> None:
        """Let the kernel refuse connections until `listen` is called. Clients stay connected."""
        if not self.is_listening:
            return
        self.is_listening = False
        self._watch()
        # On some systems a listening socket cannot stop listening, so a new socket replaces it.
        self._socket.close()
        self._socket = bound_socket(self._host, self.number, purpose=self._purpose)

    def pause(self) -> None:
        """Let new clients wait in the kernel, connected but not served, until `resume` is called."""
        self._is_accepting = False
        self._watch()

    def resume(self) -> None:
        """Accept the waiting clients."""
        self._is_accepting = True
        self._watch()

    def close(self) -> None:
        """Stop listening. Clients stay connected."""
        self.is_listening = False
        self._watch()
        self._socket.close()

    def _watch(self) -> None:
        wanted = self.is_listening and self._is_accepting and self._retry_at == _NEVER
        if wanted != self._is_watched:
            before, after = (0, selectors.EVENT_READ) if wanted else (selectors.EVENT_READ, 0)
            self._loop._register(self._socket, before, after, self)
            self._is_watched = wanted

    def _accept_one(self) -> bool:
        """Accept a connection that waits in the kernel; return False if there is none."""
        try:
            link, address = self._socket.accept()
        except OSError as error:
            # A client might disconnect before it is accepted.
            if error.errno in _EXHAUSTED:
                _log.warning("port %d cannot accept: %s", self.number, error.strerror)
                self._retry_at = self._loop.time() + _OUT_OF_DESCRIPTORS
                self._loop._is_due_at(self._retry_at)
                self._watch()
            return not isinstance(error, BlockingIOError)
        try:
            link.setblocking(False)
            # Send small replies at once, rather than when the previous reply is acknowledged.
            link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            link.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _KERNEL_BUFFER)
            # A client that has lost power sends no FIN.
            link.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        except OSError:  # some systems report here that the client has disconnected
            link.close()
            return True
        connection = Connection(self._loop, self, link, (numeric_host(address[0]), address[1]))
        if not self._has_slot():
            self.refused += 1
            link.close()
            return True
        try:
            handler = self._accept(connection)
        except Exception:
            _log.exception("%s: cannot be served", connection.name)
            self._loop.failures += 1
            handler = None
        if handler is None:
            self.refused += 1
            self._loop._drop(connection, "refused")
            return True
        connection.handler = handler
        self.accepted += 1
        if connection._is_open:  # writing the first bytes might have failed
            self.connections.add(connection)
            connection._watch()
        return True

    def _has_slot(self) -> bool:
        """Whether a slot is free for a new client.

        If no slot is free, the slot of the client that has been idle for longest is freed.
        """
        if len(self.connections) < self._limit:
            return True
        candidates = [connection for connection in self.connections if not connection.handler.is_busy]
        if not candidates:
            return False
        idlest = min(candidates, key=lambda connection: connection.last_activity)
        idle = self._loop.time() - idlest.last_activity
        if idle < self._idle:
            return False
        self.evicted += 1
        self._loop._drop(idlest, f"idle for {idle:.0f} s, and its slot is needed", reset=True)
        return True


class SelectorLoop:
    """Loop that serves sockets in the thread that calls `serve_once`.

    Args:
        clock: Monotonic clock, in seconds; a test may pass its own clock.

    Attributes:
        ports: Ports that `listen` has made.
        failures: Number of exceptions that handlers have raised.
    """

    def __init__(self, clock: Callable[[], float] = clock.now) -> None:
        #: Function that returns the current time on the loop's clock.
        self.time = clock
        self.ports: list[ListeningPort] = []
        self.failures = 0
        #: Time of the last call of `instead`; see `serve_once`.
        self.looked_at = clock()
        self._owner: int | None = None
        self._lock = threading.RLock()  # re-entrant for signal handlers
        self._is_closed = False
        self._calls: deque[tuple[Callable[[], object], Future[None]]] = deque()
        self._lost: deque[tuple[Connection, str, bool]] = deque()
        # No deadline of a connection or port is earlier than this time.
        self._earliest = _NEVER
        self._selector = selectors.DefaultSelector()
        # The selector of Linux waits in whole milliseconds, which is too coarse for a cycle of 2 ms. But it is itself a
        # descriptor, so `select`, which has a resolution of microseconds, can wait for it.
        fileno = getattr(self._selector, "fileno", int)()
        self._select_from = (fileno,) if 0 < fileno < _SELECTABLE else None
        self._waker, self._woken = socket.socketpair()
        self._waker.setblocking(False)
        self._woken.setblocking(False)
        self._selector.register(self._woken, selectors.EVENT_READ, None)
        _loops.add(self)

    def listen(
        self,
        host: str,
        number: int,
        accept: Callable[[Connection], Handler | None],
        *,
        purpose: str = "",
        limit: int = MOST_CLIENTS,
        idle: float = IDLE,
        output_limit: int = OUTPUT_LIMIT,
        chunk: int = CHUNK,
        is_listening: bool = True,
    ) -> ListeningPort:
        """Add a port.

        Args:
            host: Address to listen on. See `linkcore.net.listener` for `""` and `"::"`.
            number: Number of the port; 0 for a free port.
            accept: Function that is called with each new connection. It returns the handler of the connection, or None
                to close it at once.
            purpose: Purpose of the port, used in the error message.
            limit: Number of slots, which is the maximum number of connected clients.
            idle: Seconds without a sent or accepted byte after which the slot of a client may be given to a new client.
            output_limit: Maximum number of bytes that are buffered for one client before it is reset.
            chunk: Maximum number of bytes that are read from one client at a time.
            is_listening: Whether to listen now. If False, the number is kept, and connections are refused until
                `ListeningPort.listen` is called.

        Raises:
            BadAddress: If the loop cannot listen on the address.
        """
        port = ListeningPort(
            self, host, number, accept, purpose=purpose, limit=limit, idle=idle, output_limit=output_limit, chunk=chunk
        )
        self.ports.append(port)
        if is_listening:
            port.listen()
        return port

    # -- from any thread -------------------------------------------------------------------------------

    def wake(self) -> None:
        """End the wait of `serve_once`. Signal handlers may call this too."""
        # A full pipe has the same effect; a closed pipe belongs to a loop that has ended.
        with contextlib.suppress(OSError):
            self._waker.send(b"\0")

    def call(self, change: Callable[[], object], timeout: float) -> None:
        """Call `change` in the thread that owns the loop, while it is in `serve_once`, and wait for the result.

        If this is called in the same thread, or after the loop was closed, `change` is called at once.

        Raises:
            LinkTimeout: If the call is not done in time. If it has not begun by then, it is not made.
            Exception: If `change` raises it.
        """
        done: Future[None] | None = None
        if self._owner != threading.get_ident():
            with self._lock:
                if not self._is_closed:
                    done = Future()
                    self._calls.append((change, done))
        if done is None:
            change()
            return
        self.wake()
        if not clock.is_done(done, timeout):
            done.cancel()
            raise LinkTimeout(f"the server's thread did not respond within {timeout:g} s")
        done.result()

    # -- the owner's thread ----------------------------------------------------------------------------

    def serve_once(self, until: float | None = None, instead: Callable[[], float | None] | None = None) -> bool:
        """Wait for events until the time `until` on the loop's clock, and serve them.

        The sockets are polled once even if `until` has passed. Events that cannot be served before `until` are left for
        the next call.

        Args:
            until: Absolute time; None for no limit.
            instead: Function that does the work of the owner at `until`, if it needs neither a socket that became ready
                nor a wait. It returns the next `until`, or None if the owner must do the work itself. In simulated
                time, it is called instead of returning at `until`, because a change of threads takes longer than
                most work. In real time, it is not called.

        Returns:
            Whether there was an event before `until`.
        """
        self._owner = threading.get_ident()
        begun = self.time()
        wake_at = self._earliest if until is None else min(until, self._earliest)
        events = self._select(None if wake_at == _NEVER else max(wake_at - begun, 0.0), instead)
        slice_end = begun + _LEAST_SLICE if until is None else max(until, begun + _LEAST_SLICE)
        for key, mask in events:
            what = key.data
            if what is None:
                with contextlib.suppress(BlockingIOError):
                    self._woken.recv(4096)
                self._do_calls()
            elif isinstance(what, ListeningPort):
                for _ in range(_ACCEPTS):
                    if not what._is_watched or not what._accept_one():
                        break
            else:
                if mask & selectors.EVENT_WRITE and what._is_open:
                    what._flush()
                if mask & selectors.EVENT_READ and what._is_open and what._is_reading:
                    what._receive()
            if until is not None and self.time() >= slice_end:
                break
        now = self.time()
        if now >= self._earliest:
            self._expire(now)
        self._tell_losses()
        return bool(events)

    def close(self, within: float = 0.0) -> None:
        """Close all ports and connections. Idempotent.

        Args:
            within: Maximum time in s for sending buffered data, and for clients to read this data.
        """
        if self._is_closed:
            return
        for port in self.ports:
            port.close()
        if within > 0.0:
            until = self.time() + within
            for connection in self._connections():
                connection.finish(within)
            while self._connections() and self.time() < until:
                self.serve_once(until)
        for connection in self._connections():
            self._drop(connection, "the server was closed")
        self._tell_losses()
        with self._lock:
            self._is_closed = True
        self._do_calls()
        self._selector.close()
        self._waker.close()
        self._woken.close()

    # -- inside ----------------------------------------------------------------------------------------

    def _select(
        self, seconds: float | None, instead: Callable[[], float | None] | None
    ) -> list[tuple[selectors.SelectorKey, int]]:
        if seconds is None or seconds <= 0.0:
            return self._selector.select(seconds)
        if instead is not None and (select_or_call := getattr(self._selector, "select_or_call", None)) is not None:
            work = instead

            def call() -> float | None:
                until, now = work(), self.time()
                self.looked_at = now
                if until is None or self._calls or self._lost or self._earliest <= now:
                    return None
                return max(min(until, self._earliest) - now, 0.0)

            found: list[tuple[selectors.SelectorKey, int]] = select_or_call(seconds, call)
            return found
        if self._select_from is not None:
            return self._selector.select(0) if select.select(self._select_from, (), (), seconds)[0] else []
        # Wait for whole milliseconds, rounded down, because the selector rounds up. Then sleep for the rest.
        until = clock.now() + seconds
        events = self._selector.select(int(seconds * 1e3) * 1e-3)
        if events:
            return events
        clock.sleep(clock.left(until))
        return self._selector.select(0)

    def _register(self, link: socket.socket, before: int, after: int, data: Connection | ListeningPort) -> None:
        if not before:
            self._selector.register(link, after, data)
        elif not after:
            self._selector.unregister(link)
        else:
            self._selector.modify(link, after, data)

    def _do_calls(self) -> None:
        while self._calls:
            change, done = self._calls.popleft()
            if not done.set_running_or_notify_cancel():
                continue  # the caller no longer waits
            try:
                change()
            except BaseException as error:
                done.set_exception(error)
            else:
                done.set_result(None)

    def _guard(self, connection: Connection, method: Callable[..., object], *args: object, **named: object) -> None:
        """Call a handler. An exception ends only its own connection."""
        try:
            method(*args, **named)
        except Exception as error:
            _log.exception("%s: its handler failed", connection.name)
            self.failures += 1
            self._drop(connection, f"{type(error).__name__} in its handler", reset=True)

    def _drop(self, connection: Connection, reason: str, *, reset: bool = False, by_peer: bool = False) -> None:
        """Close a connection.

        `connection_lost` of its handler is called after the current events were served.
        """
        if not connection._is_open:
            return
        connection._is_open = False
        connection._pending.clear()
        connection.port.connections.discard(connection)
        if connection._mask:
            self._selector.unregister(connection._socket)
        if reset:
            with contextlib.suppress(OSError):
                connection._socket.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _ABORT)
        connection._socket.close()
        self._lost.append((connection, reason, by_peer))

    def _tell_losses(self) -> None:
        while self._lost:
            connection, reason, by_peer = self._lost.popleft()
            # Breaks the reference cycle, because most handlers refer to their connection.
            handler, connection.handler = connection.handler, Handler()
            self._guard(connection, handler.connection_lost, reason, by_peer=by_peer)

    def _is_due_at(self, when: float) -> None:
        self._earliest = min(self._earliest, when)

    def _expire(self, now: float) -> None:
        for port in self.ports:
            if port._retry_at <= now:
                port._retry_at = _NEVER
                port._watch()
        for connection in self._connections():
            if connection._deadline <= now:
                self._drop(connection, connection._deadline_reason, reset=not connection._is_finishing)
        self._earliest = min(
            [_NEVER]
            + [connection._deadline for connection in self._connections()]
            + [port._retry_at for port in self.ports]
        )

    def _connections(self) -> list[Connection]:
        return [connection for port in self.ports for connection in port.connections]

    def _leave_to_parent(self) -> None:
        # Only close the selector, and unregister no socket: on Linux the selector is shared with the parent, which
        # would lose these sockets too.
        self._is_closed = True
        for connection in self._connections():
            connection._is_open = False
            connection._socket.close()
        for port in self.ports:
            port._socket.close()
        self._waker.close()
        self._woken.close()
        # A child does not inherit a kqueue (macOS), so closing it fails before CPython 3.11.7 and 3.12.1.
        with contextlib.suppress(OSError):
            self._selector.close()


#: All loops of this process.
_loops: weakref.WeakSet[SelectorLoop] = weakref.WeakSet()


def _leave_all_to_parent() -> None:
    """Close the copies of the sockets in a forked child, so that the child cannot disturb the parent's clients.

    An open copy would also prevent the kernel from ending a connection that the parent closes.
    """
    for loop in list(_loops):
        loop._leave_to_parent()


if hasattr(os, "register_at_fork"):  # not on Windows, which cannot fork
    os.register_at_fork(after_in_child=_leave_all_to_parent)

"""A selector loop that serves many TCP clients from one thread, and never waits for any of them.

A server of this project (the simulated controller, the RHD host) is a `SelectorLoop` with one `ListeningPort` for each
TCP port, and a `Handler` for each connection, which is sans-IO: bytes in, `Connection.write` out. The thread that owns
the loop calls `serve_once` between two of its own deadlines, such as the cycles of a controller::

    loop = SelectorLoop()
    loop.listen("127.0.0.1", 0, accept)            # accept(connection) -> Handler
    while not is_closing:
        do_what_is_due()
        loop.serve_once(until=next_deadline)
    loop.close()

Everything here belongs to that thread, except `wake`, `call`, and reading the counters.

What a client can do to others is bounded: each look at the sockets takes one chunk from each client; what a client does
not read is kept up to `output_limit` bytes, then the connection is reset; a port has a limit of clients, and gives the
slot of an idle one to a new one; a connection can have a deadline, after which it is reset.
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
from collections.abc import Callable
from concurrent.futures import Future

from .. import clock
from ..errors import BadAddress, LinkTimeout
from .listener import bound_socket, numeric_host

_log = logging.getLogger(__name__)

#: Clients of one port, by default.
MOST_CLIENTS = 100
#: Seconds after which the slot of a client that neither sends nor takes a byte may go to a new client.
IDLE = 60.0
#: Bytes that may wait for one client, beside what the kernel holds for it.
OUTPUT_LIMIT = 1 << 20
#: Bytes taken from one client at a time.
CHUNK = 1 << 16

# Connections that wait in the kernel to be accepted, and those that are accepted in one look.
_BACKLOG, _ACCEPTS = 64, 16
# Bytes that the kernel may hold for a client. Left to itself it grows to megabytes: seconds of old data.
_KERNEL_BUFFER = 1 << 18
# Seconds for which events are served in one go, even if the owner is late already; its clients would starve otherwise.
_LEAST_SLICE = 1e-3
# Seconds without accepting after the process ran out of descriptors; the kernel would report the same again at once.
_OUT_OF_DESCRIPTORS = 0.2
_EXHAUSTED = {errno.EMFILE, errno.ENFILE, errno.ENOBUFS, errno.ENOMEM}
# `select` takes no descriptors from this one on.
_SELECTABLE = 1024
# Closing with this option set resets the connection, and discards what the kernel still holds for it.
_ABORT = struct.pack("ii", 1, 0)
_NEVER = math.inf


class Handler:
    """What a server makes of the bytes of one connection. Its methods are called by the thread that owns the loop.

    An exception in one of them is logged with its traceback and ends this connection only.
    """

    @property
    def is_busy(self) -> bool:
        """Whether the client keeps its slot although no bytes pass, because it waits for something of this server."""
        return False

    def data_received(self, data: bytes) -> None:
        """Bytes have come, as they came: a protocol finds its own frame boundaries."""

    def drained(self) -> None:
        """All that was written has been taken by the kernel, after some of it had to wait."""

    def connection_lost(self, reason: str, *, by_peer: bool) -> None:
        """The connection is closed; no other method is called after this one.

        Args:
            reason: why, for a log.
            by_peer: the peer closed or reset it, rather than this side.
        """


class Connection:
    """One client, as its handler sees it.

    Attributes:
        port: the port that it came to.
        peer: (numeric host, port) of the client.
        handler: what its bytes go to.
        last_activity: time on the loop's clock at which it last sent a byte, or took one.
    """

    def __init__(self, loop: SelectorLoop, port: ListeningPort, link: socket.socket, peer: tuple[str, int]) -> None:
        self.port = port
        self.peer = peer
        self.handler = Handler()
        self.last_activity = loop.time()
        self._loop = loop
        self._socket = link
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
        """host:port of the client, for messages."""
        host, port = self.peer
        return f"[{host}]:{port}" if ":" in host else f"{host}:{port}"

    @property
    def is_open(self) -> bool:
        """It is connected, and neither `close` nor `finish` was called."""
        return self._is_open and not self._is_finishing

    @property
    def pending(self) -> int:
        """Bytes written that the kernel has not taken yet."""
        return len(self._pending)

    # -- output --------------------------------------------------------------------------------------

    def write(self, data: bytes) -> None:
        """Send, now what the kernel takes and the rest later. Without effect once the connection is closed.

        A client that does not read is reset as soon as more than the port's `output_limit` would wait for it.
        """
        if not self.is_open or self._is_deaf:
            return
        if not self._pending:
            sent = self._send(data)
            if sent == len(data) or self._is_deaf:
                return
            data = data[sent:]
        self._pending += data
        if len(self._pending) > self.port.output_limit:
            self.port.overflowed += 1
            self._loop._drop(self, f"did not read: {len(self._pending)} bytes wait for it", reset=True)
        else:
            self._watch()

    def _send(self, data: bytes | bytearray) -> int:
        try:
            sent = self._socket.send(data)
        except BlockingIOError:
            return 0
        except OSError:
            # The peer takes no more. What it sent before is still there: a command, perhaps, by a client that closes
            # without having read. The connection ends when that has been taken.
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
        """Take no more from the client, which then has to wait (back-pressure), until `resume_reading`."""
        self._is_reading = False
        self._watch()

    def resume_reading(self) -> None:
        """Take again what the client sends."""
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
        """Reset the connection at this time on the loop's clock, unless the deadline is changed or cleared before.

        Args:
            when: absolute; see `SelectorLoop.time`.
            reason: what the client failed to do by then, for `Handler.connection_lost`.
        """
        self._deadline, self._deadline_reason = when, reason
        self._loop._is_due_at(when)

    def clear_deadline(self) -> None:
        """The client has done what it had to."""
        self._deadline = _NEVER

    def close(self, *, reset: bool = False, reason: str = "closed by this side") -> None:
        """End the connection now. What waits is discarded, but for what the kernel holds already. Idempotent.

        Args:
            reset: discard that too: the client sees a reset rather than an end.
            reason: for `Handler.connection_lost`.
        """
        self._loop._drop(self, reason, reset=reset)

    def finish(self, within: float) -> None:
        """End the connection in order: send what waits, and wait until the client closes too; all in `within` seconds.

        What the client sends meanwhile is thrown away. To close at once while bytes of the client are still unread
        would reset the connection, and the client could lose the last reply.
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
        """Ask the selector for what this connection can do next."""
        if not self._is_open:
            return
        mask = (selectors.EVENT_READ if self._is_reading else 0) | (selectors.EVENT_WRITE if self._pending else 0)
        if mask != self._mask:
            self._loop._register(self._socket, self._mask, mask, self)
            self._mask = mask


class ListeningPort:
    """One TCP port of a server, and the clients connected to it. Made by `SelectorLoop.listen`.

    Attributes:
        number: that it listens on.
        is_listening: clients can connect; otherwise the number is kept and connections are refused by the kernel.
        connections: the clients at present.
        output_limit: bytes that may wait for one client.
        chunk: bytes taken from one client at a time.
        accepted: connections so far.
        refused: connections that were closed at once: every slot was taken, or `accept` returned None.
        evicted: idle clients whose slot was given to a new one.
        overflowed: clients that were reset because they did not read.
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
            BadAddress: another socket, bound to the same number before, listens already.
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
        """Let the kernel refuse connections until `listen`. The clients that are connected stay."""
        if not self.is_listening:
            return
        self.is_listening = False
        self._watch()
        # A socket that has begun to listen cannot stop on every system, so another one takes its place.
        self._socket.close()
        self._socket = bound_socket(self._host, self.number, purpose=self._purpose)

    def pause(self) -> None:
        """Let new clients wait in the kernel, connected and not answered, until `resume`."""
        self._is_accepting = False
        self._watch()

    def resume(self) -> None:
        """Accept those who waited."""
        self._is_accepting = True
        self._watch()

    def close(self) -> None:
        """Listen no longer. The clients that are connected stay."""
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
        """Accept a connection that waits in the kernel; False if none does."""
        try:
            link, address = self._socket.accept()
        except OSError as error:
            # A client may be gone again before it is accepted.
            if error.errno in _EXHAUSTED:
                _log.warning("port %d cannot accept: %s", self.number, error.strerror)
                self._retry_at = self._loop.time() + _OUT_OF_DESCRIPTORS
                self._loop._is_due_at(self._retry_at)
                self._watch()
            return not isinstance(error, BlockingIOError)
        try:
            link.setblocking(False)
            # Small replies go out at once rather than when the one before is acknowledged.
            link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            link.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _KERNEL_BUFFER)
            # A client that lost power sends no FIN.
            link.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        except OSError:  # some systems say here that the client is gone
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
        if connection._is_open:  # the first bytes that were written to it may have failed
            self.connections.add(connection)
            connection._watch()
        return True

    def _has_slot(self) -> bool:
        """Whether there is a slot for one more client; takes that of the one idle for longest, where there is none."""
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
    """Sockets, served by the one thread that calls `serve_once`.

    Args:
        clock: seconds, monotonic; a test may have one of its own.

    Attributes:
        ports: made by `listen`.
        failures: exceptions that handlers raised.
    """

    def __init__(self, clock: Callable[[], float] = clock.now) -> None:
        #: now, on the loop's clock
        self.time = clock
        self.ports: list[ListeningPort] = []
        self.failures = 0
        self._owner: int | None = None
        self._lock = threading.RLock()  # re-entrant, for signal handlers
        self._is_closed = False
        self._calls: deque[tuple[Callable[[], object], Future[None]]] = deque()
        self._lost: deque[tuple[Connection, str, bool]] = deque()
        # No deadline of a connection or port is earlier than this.
        self._earliest = _NEVER
        self._selector = selectors.DefaultSelector()
        # The selector of Linux waits in whole milliseconds, too coarse for a cycle of two. But it is a descriptor
        # itself, and `select`, which can be told microseconds, waits for it.
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
        """One more port.

        Args:
            host: address to listen on; see `linkcore.net.listener` for `""` and `"::"`.
            number: of the port; 0 for one that is free.
            accept: called with each new connection; the handler of its bytes, or None to close it at once.
            purpose: what the port is for; stands in the error's text.
            limit: slots: clients that may be connected at once.
            idle: seconds after which the slot of a client that neither sends nor takes a byte may go to a new client.
            output_limit: bytes that may wait for one client before it is reset.
            chunk: bytes taken from one client at a time.
            is_listening: False to keep the number and refuse connections until `ListeningPort.listen`.

        Raises:
            BadAddress: that cannot be listened on.
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
        """End a `serve_once` that waits; also from a signal handler."""
        # A full pipe wakes as well; a closed one belongs to a loop that has ended.
        with contextlib.suppress(OSError):
            self._waker.send(b"\0")

    def call(self, change: Callable[[], object], timeout: float) -> None:
        """Do something in the thread that owns the loop, while it is in `serve_once`, and wait until it is done.

        In that thread itself, and once the loop is closed, it is done at once.

        Raises:
            LinkTimeout: it was not done in time. What has not begun by then is not done any more.
            Exception: whatever `change` raises.
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
            raise LinkTimeout(f"the server's thread did not answer within {timeout:g} s")
        done.result()

    # -- the owner's thread ----------------------------------------------------------------------------

    def serve_once(self, until: float | None = None) -> bool:
        """Wait for something to happen until the time `until` on the loop's clock, and serve what has happened.

        Sockets are looked at once even if `until` is over. What takes longer than `until` is left for the next time.

        Args:
            until: absolute; None for as long as it takes.

        Returns:
            Whether anything happened before the time was up.
        """
        self._owner = threading.get_ident()
        begun = self.time()
        wake_at = self._earliest if until is None else min(until, self._earliest)
        events = self._select(None if wake_at == _NEVER else max(wake_at - begun, 0.0))
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
            within: seconds for which what waits is still sent, and clients are given time to take it.
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
            self._drop(connection, "the server ends")
        self._tell_losses()
        with self._lock:
            self._is_closed = True
        self._do_calls()
        self._selector.close()
        self._waker.close()
        self._woken.close()

    # -- inside ----------------------------------------------------------------------------------------

    def _select(self, seconds: float | None) -> list[tuple[selectors.SelectorKey, int]]:
        if seconds is None or seconds <= 0.0:
            return self._selector.select(seconds)
        if self._select_from is not None:
            return self._selector.select(0) if select.select(self._select_from, (), (), seconds)[0] else []
        # Whole milliseconds, rounded down, since the selector rounds up. The last part is slept.
        whole = int(seconds * 1e3) * 1e-3
        events = self._selector.select(whole)
        if not events and whole == 0.0:
            clock.sleep(seconds)
        return events

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
                continue  # its caller waits no longer
            try:
                change()
            except BaseException as error:
                done.set_exception(error)
            else:
                done.set_result(None)

    def _guard(self, connection: Connection, method: Callable[..., object], *args: object, **named: object) -> None:
        """Call a handler. What it raises ends its own connection only."""
        try:
            method(*args, **named)
        except Exception as error:
            _log.exception("%s: its handler failed", connection.name)
            self.failures += 1
            self._drop(connection, f"{type(error).__name__} in its handler", reset=True)

    def _drop(self, connection: Connection, reason: str, *, reset: bool = False, by_peer: bool = False) -> None:
        """Close a connection; its handler's `connection_lost` is called when the events at hand have been served."""
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
            # Most refer to their connection: without this a cycle would stay.
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
        # The selector is closed and told of nothing else: that of Linux is shared with the parent, which would lose
        # what is taken out of it here.
        self._is_closed = True
        for connection in self._connections():
            connection._is_open = False
            connection._socket.close()
        for port in self.ports:
            port._socket.close()
        self._selector.close()
        self._waker.close()
        self._woken.close()


#: The loops of this process.
_loops: weakref.WeakSet[SelectorLoop] = weakref.WeakSet()


def _leave_all_to_parent() -> None:
    """Run in a forked child: close its copies of the sockets, so that nothing it calls disturbs the parent's clients.

    A copy that stayed open would also keep the kernel from ending a connection that the parent closes.
    """
    for loop in list(_loops):
        loop._leave_to_parent()


if hasattr(os, "register_at_fork"):  # not on Windows, which cannot fork
    os.register_at_fork(after_in_child=_leave_all_to_parent)

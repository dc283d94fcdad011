"""Transports, which are sources of bytes, and `TcpTransport`, a TCP connection with deadlines.

A transport is opened, read until it raises an error, closed, and opened again. It raises only errors of this library.
Errors of the operating system are converted in this module and nowhere else.

Data of a failed call must not arrive later. Normally, after `send` has passed data to the kernel, TCP retransmits this
data for several minutes, even after `close` and after the end of the process (`tcp_retries2` of Linux: about 15
minutes). The data then arrives when the network is available again. A robot would execute a motion although the call
for this motion failed long ago. Three measures prevent this:

- `SO_LINGER` of 0 s is set from the beginning. When the connection ends, by `abort`, a crash of the process or the
  garbage collector, the kernel discards its data and resets the connection (tcp(7), RFC 1122 section 4.2.2.13).
- `close` is orderly: it first waits, for a limited time, until the peer's kernel has acknowledged everything.
- `TCP_USER_TIMEOUT` (RFC 5482; Linux): the kernel ends the connection on its own if no data is acknowledged for as long
  as the peer may be silent. This works even while this process is suspended or delayed, so that no thread can call
  `abort`. On macOS, `TCP_RXT_CONNDROPTIME` limits the retransmissions in the same way, in whole seconds.
"""

from __future__ import annotations

import contextlib
import errno
import math
import os
import select
import socket
import struct
import sys
import time
import weakref
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any, Protocol

from .. import clock
from ..clock import Stamp
from ..deferred import Deferred, SteadyBytes
from ..errors import ConnectFailed, ConnectionLost, LinkError, LinkTimeout, LocalError, RemoteError, unraised
from ..pending_call import check_wanted, interruptible
from ..process import HomeProcess
from ..threads import MadeOnce

if sys.platform == "linux":
    import fcntl
    import termios

#: Bytes requested per read: about 60 packets if the reader has fallen behind.
_CHUNK = 65536

#: Maximum time in s that `close` waits for acknowledgements, because the peer might not have received a stop yet. Linux
#: delays an acknowledgement by up to 40 ms. The rest is for two retransmissions, which Linux makes 200 and 600 ms after
#: the first try at the earliest.
_DRAIN = 0.7

#: Interval in s at which a sender that waits for room checks whether this program has closed the connection, because
#: poll does not report this on every system.
_SLICE = 0.05

#: Makes a NamedTuple without its own `__new__`, which would be a call of Python code for each packet.
_new_stamp = tuple.__new__


class Finished(Exception):
    """Regular end of the bytes, at the end of a recording."""


class Transport(Protocol):
    """Source of bytes, which can be opened again after its end."""

    #: Name of the peer, used in messages.
    name: str

    @property
    def round_trip(self) -> float:
        """Duration of the handshake (a round trip) of the last connection, in s.

        It is `inf` if there was no handshake.
        """

    def open(self, timeout: float) -> None:
        """Connect within `timeout` seconds; raises `RemoteError`."""

    def receive(self, timeout: float | None = None) -> tuple[bytes, Stamp]:
        """Wait up to `timeout` seconds for bytes; return them with the time of their arrival.

        Raises `LinkTimeout`, `ConnectionLost` or `Finished`.
        """

    def send(self, data: bytes, timeout: float) -> None:
        """Send all of `data` within `timeout` seconds; raises `RemoteError`."""

    def send_some(self, data: bytes | memoryview) -> int:
        """Send the bytes that are accepted at once; return their number.

        Never waits; raises `ConnectionLost`.
        """

    def wait_for_room(self, timeout: float) -> bool:
        """Wait until `send_some` can send; return False after `timeout` seconds; raises `ConnectionLost`."""

    def abort(self) -> None:
        """Disconnect at once, discard undelivered data, and wake waiting threads.

        Idempotent, in any thread.
        """

    def close(self) -> None:
        """Wait until sent data is delivered, for a limited time; then disconnect as `abort` does."""


class TcpTransport:
    """TCP connection. It is made by `open`, or by a peer; in the second case, pass its socket to `adopt`.

    Args:
        host: Host name or address.
        port: TCP port.
        silence: Seconds without a byte after which `receive` raises `LinkTimeout`. Also the seconds without an
            acknowledgement after which the kernel aborts the connection.
        refused: Function that returns a hint for the error if the connection is refused, such as the setting that might
            be the cause; "" for no hint.

    Attributes:
        round_trip: See `Transport`.
        delivers_deferred: Whether the connection is simulated, so that `accept_deferred` lets `receive` return packets
            whose bytes are not made yet.
    """

    def __init__(self, host: str, port: int, *, silence: float, refused: Callable[[], str] = str) -> None:
        self.host = host
        self.port = port
        self.silence = silence
        self.name = f"{host}:{port}"
        self.round_trip = math.inf
        self.delivers_deferred = False
        self._refused = refused
        self._home = HomeProcess(self.name)
        self._socket: socket.socket | None = None
        # The same socket, until one thread removes it in one step to close it. Two threads that closed a descriptor at
        # the same time could close the descriptor of another connection.
        self._owned: MadeOnce[socket.socket] = MadeOnce()
        self._receive_timeout = silence  # current timeout of the socket
        self._recv: Callable[[int], bytes]  # `recv` of the current or last socket
        #: Function that is called with the bytes of each successful call of `send_some`; None for none.
        self.sent: Callable[[bytes | memoryview], object] | None = None

    def another(self) -> TcpTransport:
        """Return a new transport to the same port, which is not connected."""
        other = TcpTransport(self.host, self.port, silence=self.silence, refused=self._refused)
        other.sent = self.sent
        return other

    def open(self, timeout: float) -> None:
        """Connect within `timeout` seconds.

        Raises:
            ConnectFailed: If the connection is refused, or the host is unreachable or unknown.
            LinkTimeout: If the host does not answer in time.
            LocalError: If this process was forked from the process that made the transport. All other methods raise it
                too.
            Cancelled: If this thread is making a pending call that was abandoned. See `linkcore.pending_call`.
        """
        self._home.check()
        self.abort()
        try:
            connection, self.round_trip = _connected(self.host, self.port, timeout)
        except (OSError, ValueError) as error:
            raise self.failure(error, timeout) from error
        self.adopt(connection, ConnectFailed)

    def failure(self, error: OSError | ValueError, timeout: float) -> RemoteError:
        """Return the error for a connection that could not be made within `timeout` seconds."""
        failure = mapped(error, f"cannot connect to {self.name}", timeout, ConnectFailed)
        hint = self._refused() if isinstance(error, ConnectionRefusedError) else ""
        return ConnectFailed(f"{failure}; {hint}") if hint else failure

    def adopt(self, connection: socket.socket, otherwise: type[RemoteError] = ConnectionLost) -> None:
        """Use a connected socket.

        Raises:
            otherwise: If the connection has already ended. The socket is closed.
        """
        try:
            _prepare(connection, self.silence)
        except OSError as error:
            connection.close()
            raise mapped(error, self.name, self.silence, otherwise) from error
        self._receive_timeout = self.silence
        owned = connection if _witness is None else _witness(self, connection)
        # Only a simulated socket can pass on packets whose bytes are not made yet. A witness needs the bytes.
        deferred = None if _witness is not None else getattr(owned, "recv_deferred", None)
        self.delivers_deferred = deferred is not None
        self._recv = owned.recv
        self._owned.keep(owned)
        self._socket = owned
        _connections.add(self)

    def accept_deferred(
        self,
        takes_batches: Callable[[], bool],
        take_in_place: Callable[[Deferred | SteadyBytes], tuple[bool, float | None]],
    ) -> None:
        """Let `receive` return packets whose bytes are not made yet. Call it only if `delivers_deferred` is true.

        Args:
            takes_batches: Function that returns whether several packets may arrive at once; see `DeferredBatch`.
            take_in_place: Function that takes a packet in place of the thread that waits in `receive`; see
                `linkcore.simulated.sockets.Socket`.
        """
        connection: Any = self._socket
        if connection is not None:
            self._recv = connection.recv_deferred
            connection.takes_batches, connection.take_in_place = takes_batches, take_in_place

    def receive(self, timeout: float | None = None) -> tuple[bytes, Stamp]:
        """Wait for bytes; return them with the time of their arrival.

        Args:
            timeout: Maximum wait for the first byte, in s; by default `silence`.

        Raises:
            LinkTimeout: If nothing arrives in time. The kernel itself waits, so a delay of this thread is not counted.
            ConnectionLost: If the peer closes or resets the connection, `close` or `abort` is called, or the kernel
                aborts the connection because data is not acknowledged.
        """
        connection = self._socket
        if connection is None:
            raise self._unconnected()
        if timeout is None:
            timeout = self.silence
        try:
            if timeout != self._receive_timeout:
                self._set_receive_timeout(connection, max(timeout, 0.0))
            data = self._recv(_CHUNK)
        except OSError as error:
            # On Windows, the timeout is Python's own, whose error has no number.
            if isinstance(error, BlockingIOError) or (isinstance(error, TimeoutError) and error.errno is None):
                raise LinkTimeout(f"{self.name}: nothing received within {max(timeout, 0.0):g} s") from None
            raise mapped(error, self.name, timeout, ConnectionLost) from error
        if not data:
            raise self._ended(connection)
        return data, _new_stamp(Stamp, (clock.read(), time.time()))

    def fileno(self) -> int:
        """Return the descriptor of the socket, to wait for several sockets at once.

        Return -1 if there is none.
        """
        connection = self._socket
        return -1 if connection is None else connection.fileno()

    def receive_waiting(self) -> tuple[bytes, Stamp] | None:
        """Return the bytes that have already arrived, or None; never waits.

        Raises:
            ConnectionLost: If the peer has closed or reset the connection, or this program has closed it.
        """
        connection = self._socket
        if connection is None:
            raise self._unconnected()
        try:
            if sys.platform == "win32":
                connection.settimeout(0)
                self._receive_timeout = 0.0
            data = connection.recv(_CHUNK, getattr(socket, "MSG_DONTWAIT", 0))
        except BlockingIOError:
            return None
        except OSError as error:
            raise mapped(error, self.name, 0.0, ConnectionLost) from error
        if not data:
            raise self._ended(connection)
        return data, _new_stamp(Stamp, (clock.read(), time.time()))

    def _unconnected(self) -> LinkError:
        try:
            self._home.check()
        except LocalError as error:
            return error
        return ConnectionLost(f"{self.name} is not connected")

    def _set_receive_timeout(self, connection: socket.socket, timeout: float) -> None:
        # If the timeout is the rest of a deadline, it changes with each packet. A difference of one percent is not
        # worth a system call.
        if not 0.99 * self._receive_timeout <= timeout <= self._receive_timeout:
            _set_receive_timeout(connection, timeout)
            self._receive_timeout = timeout

    def _ended(self, connection: socket.socket) -> ConnectionLost:
        by = "closed the connection" if self._socket is connection else "was closed by this program"
        return ConnectionLost(f"{self.name} {by}")

    def send(self, data: bytes, timeout: float) -> None:
        """Send all of `data` within `timeout` seconds, by passing it to the kernel.

        Raises:
            LinkTimeout: If the peer does not accept the data in time. A part of the data might have been sent.
            ConnectionLost: If the connection is lost.
        """
        until = clock.now() + timeout
        rest = memoryview(data)
        while rest:
            sent = self.send_some(rest)
            rest = rest[sent:]
            if not sent and not self.wait_for_room(until - clock.now()):
                raise LinkTimeout(f"sending to {self.name}: the peer did not accept the data within {timeout:g} s")

    def send_some(self, data: bytes | memoryview) -> int:
        """Pass to the kernel as many bytes of `data` as it accepts at once; return their number.

        Never waits.

        Raises:
            ConnectionLost: If the connection is lost.
            Cancelled: If this thread is making a pending call that was abandoned. See `linkcore.pending_call`.
        """
        connection = self._socket
        if connection is None:
            raise self._unconnected()
        check_wanted()
        # The socket blocks, because `receive` needs this. If `send` has no flag against waiting, check for room first.
        flags = getattr(socket, "MSG_DONTWAIT", 0)
        try:
            if not flags and not _has_room(connection, 0.0):
                return 0
            count = connection.send(data, flags)
            if self.sent is not None:
                self.sent(data[:count])
            return count
        except BlockingIOError:  # there is no room, or another thread has just taken it
            return 0
        except OSError as error:
            raise mapped(error, f"sending to {self.name}", 0.0, ConnectionLost) from error

    def wait_for_room(self, timeout: float) -> bool:
        """Wait until `send_some` can send; return False after `timeout` seconds.

        Raises:
            ConnectionLost: If the connection is lost.
            Cancelled: See `send_some`.
        """
        until = clock.now() + timeout
        while (connection := self._socket) is not None:
            left = clock.left(until)
            try:
                if _has_room(connection, min(left, _SLICE)):
                    return True
            except OSError as error:
                raise mapped(error, f"sending to {self.name}", timeout, ConnectionLost) from error
            if left <= _SLICE:
                return False
            check_wanted()
        self._home.check()
        raise ConnectionLost(f"sending to {self.name}: closed by this program")

    def abort(self) -> None:
        """Disconnect at once, so that the kernel discards unacknowledged data.

        Wakes threads that receive or send.
        """
        self._socket = None
        connection = self._owned.take()
        if connection is None:  # it is not connected, or another thread closes it
            return
        # Do not use SHUT_RDWR. It would append the end of the stream to the bytes that must be discarded, and deliver
        # both.
        with contextlib.suppress(OSError):  # already disconnected, so no thread waits on it
            connection.shutdown(socket.SHUT_RD)
        connection.close()

    def close(self, timeout: float = _DRAIN) -> None:
        """Disconnect when the peer has acknowledged all sent data, but after `timeout` seconds at the latest.

        After `timeout`, unacknowledged data is discarded, as by `abort`. `receive` continues during the wait. Linux and
        macOS report unacknowledged data, but Windows does not. There, the connection is closed at once, and the kernel
        continues to deliver the data. Call `abort` if data must not arrive any more.
        """
        for pause in self.closing(timeout):
            clock.sleep(pause)

    def closing(self, timeout: float = _DRAIN) -> Iterator[float]:
        """Close step by step, as `close` does; yield the seconds to wait before the next step.

        The caller must exhaust the iterator, or call `abort`.
        """
        connection = self._socket
        if connection is None:
            return
        with contextlib.suppress(OSError, ValueError):  # ended by the peer, or by `abort` in another thread
            connection.shutdown(socket.SHUT_WR)  # from now on, another thread that sends gets an error
            until = clock.now() + timeout
            # An acknowledgement takes about 50 us on a local network, and up to 40 ms if it is delayed.
            pause = 0.0002
            # No data is added meanwhile.
            while (is_under_way := _unacknowledged(connection) > 0) and clock.now() < until:
                yield pause
                pause = min(2 * pause, 0.01)
            if not is_under_way:
                connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _LINGER.pack(0, 0))
        self.abort()


#: Function that gets each connected socket, and returns the object to use instead.
_witness: Callable[[TcpTransport, Any], Any] | None = None


@contextlib.contextmanager
def witnessed(witness: Callable[[TcpTransport, Any], Any]) -> Iterator[None]:
    """Call a witness for every connection that this process makes within the block.

    Args:
        witness: Function that gets the transport and its socket, in the thread that has connected. It returns the
            object that the transport uses instead of the socket, such as an object that records the traffic.
    """
    global _witness
    before, _witness = _witness, witness
    try:
        yield
    finally:
        _witness = before


#: All connected transports.
_connections: weakref.WeakSet[TcpTransport] = weakref.WeakSet()


def _leave_to_parent() -> None:
    """Close the copies of the sockets in a forked child, so that the child cannot end the parent's connections.

    An open copy would also prevent the kernel from ending a connection that the parent closes.
    """
    for transport in list(_connections):
        transport._socket = None
        connection = transport._owned.take()
        if connection is not None:
            connection.close()


if hasattr(os, "register_at_fork"):  # not on Windows, which cannot fork
    os.register_at_fork(after_in_child=_leave_to_parent)


def _connected(host: str, port: int, timeout: float) -> tuple[socket.socket, float]:
    """Return a connection to the first address of `host` that answers, and the duration of its handshake in s.

    `timeout` is the maximum time for all addresses together.
    """
    until = clock.now() + timeout
    places = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)
    failure: OSError | None = None
    for number, (family, kind, protocol, _, address) in enumerate(places):
        left = (until - clock.now()) / (len(places) - number)
        connection = None
        try:
            connection = socket.socket(family, kind, protocol)
            connection.settimeout(max(left, 1e-3))
            began = clock.now()
            with interruptible(partial(_interrupt, connection)):
                connection.connect(address)
            round_trip = clock.now() - began
        except OSError as error:
            failure = unraised(error)
            if connection is not None:
                connection.close()
        except BaseException:
            if connection is not None:
                connection.close()
            raise
        else:
            return connection, round_trip
    try:
        raise failure or OSError(f"{host} has no address")
    finally:
        failure = None  # breaks the reference cycle between the error and this frame


def _interrupt(connection: socket.socket) -> None:
    """End the wait of another thread that is connecting this socket.

    On systems other than Linux, the wait might last until its timeout.
    """
    with contextlib.suppress(OSError):
        connection.shutdown(socket.SHUT_RDWR)


#: TCP_RXT_CONNDROPTIME of netinet/tcp.h of macOS, in s; the module `socket` does not define it. Not verified on a Mac.
_DROP_TIME = 0x80

#: SO_NWRITE of sys/socket.h of macOS: number of bytes in the send buffer. Not verified on a Mac.
_SO_NWRITE = 0x1024

#: struct linger: whether lingering is on, and its time in s. The struct has two ints; on Windows, two shorts
#: (winsock2.h).
_LINGER = struct.Struct("hh" if sys.platform == "win32" else "ii")


#: Option of Windows: seconds after which unacknowledged data ends the connection.
_TCP_MAXRT = 5


def _prepare(connection: socket.socket, silence: float) -> None:
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _LINGER.pack(1, 0))
    # A controller that has lost power sends no FIN. `silence` detects this sooner; keepalive frees the socket.
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    if hasattr(socket, "TCP_USER_TIMEOUT"):
        # The option is in ms; 0 would select the system's default. It equals `silence`, because after this time the
        # connection is considered lost on this side too.
        milliseconds = min(max(round(silence * 1e3), 1), 2**31 - 1)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, milliseconds)
    elif sys.platform == "win32":
        # 0 would select the system's default. It was not verified on Windows; Wine rejects it.
        with contextlib.suppress(OSError):
            connection.setsockopt(socket.IPPROTO_TCP, _TCP_MAXRT, _whole_seconds(silence))
    elif sys.platform == "darwin":
        connection.setsockopt(socket.IPPROTO_TCP, _DROP_TIME, _whole_seconds(silence))
    _set_receive_timeout(connection, silence)


def _whole_seconds(silence: float) -> int:
    """Return `silence` rounded up for a kernel that counts in s, where 0 would mean no limit."""
    return min(max(math.ceil(silence), 1), 2**31 - 1) if math.isfinite(silence) else 2**31 - 1


def _has_room(connection: socket.socket, seconds: float) -> bool:
    """Wait until data can be sent; return False after `seconds`.

    Raises:
        OSError: If the connection has ended, or this program has ended it.
    """
    number = connection.fileno()
    if number < 0:
        raise OSError(errno.EBADF, "closed")
    if sys.platform == "win32":
        return bool(select.select([], [connection], [], seconds)[1])
    else:
        # Do not use `select`. It accepts no descriptors above 1023, and a program with many robots has such
        # descriptors. While poll waits, the kernel keeps the socket open, so `abort` takes effect when poll returns.
        # With POLLRDHUP, SHUT_RD wakes poll (Linux).
        ended: int = getattr(select, "POLLRDHUP", 0)
        poll = select.poll()
        poll.register(number, select.POLLOUT | ended)
        events = sum(mask for _, mask in poll.poll(seconds * 1e3))
        if events & ended and not events & select.POLLOUT:
            raise OSError(errno.EPIPE, "the connection ended")
        return bool(events)


def _unacknowledged(connection: socket.socket) -> int:
    """Return the number of unacknowledged bytes of a connection after SHUT_WR.

    The FIN is not counted, because it does not have to be acknowledged. Return 0 if the system does not report it.
    """
    if sys.platform == "linux":
        # SIOCOUTQ has the number of TIOCOUTQ (linux/sockios.h). It counts the FIN as one byte.
        (count,) = struct.unpack("i", fcntl.ioctl(connection, termios.TIOCOUTQ, bytes(4)))
        return max(int(count) - 1, 0)
    elif sys.platform == "darwin":
        return connection.getsockopt(socket.SOL_SOCKET, _SO_NWRITE)
    else:
        return 0


def _set_receive_timeout(connection: socket.socket, seconds: float) -> None:
    """Set the timeout of `recv`.

    Python's own timeout needs two system calls for each packet, poll and recv; the kernel's timeout needs one.
    """
    if sys.platform == "win32":
        connection.settimeout(seconds)
    else:
        connection.settimeout(None)
        # struct timeval consists of two numbers of 4 or 8 bytes each; the size of the option shows their size. Two
        # numbers of type `long` would be wrong on a 32-bit system with a 64-bit time_t (Debian 13, and Raspberry Pi OS
        # based on it), where each number has 8 bytes.
        size = len(connection.getsockopt(socket.SOL_SOCKET, socket.SO_RCVTIMEO, 32))
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVTIMEO, _timeval(seconds, size))


def _timeval(seconds: float, size: int) -> bytes:
    """Return a struct timeval of `size` bytes. It is never 0, which would mean no timeout."""
    whole = int(seconds)
    return struct.pack("qq" if size == 16 else "ii", whole, max(int((seconds - whole) * 1e6), 1))


def is_unknown_host(error: RemoteError) -> bool:
    """Whether a connection could not be made because the name of its host is unknown."""
    return isinstance(error.__cause__, (socket.gaierror, ValueError))


def mapped(error: OSError | ValueError, doing: str, timeout: float, otherwise: type[RemoteError]) -> RemoteError:
    """Convert an error of the operating system to an error of this library.

    No other code does this.
    """
    if isinstance(error, ValueError):  # a part of the name is too long, or contains an invalid character
        return otherwise(f"{doing}: no such host ({error})")
    if error.errno == errno.ETIMEDOUT and otherwise is ConnectionLost:
        # This is not a timeout of `recv`: TCP_USER_TIMEOUT or keepalive has ended the connection.
        return otherwise(f"{doing}: the peer no longer acknowledges sent data, so the connection was aborted")
    if isinstance(error, TimeoutError):
        return LinkTimeout(f"{doing}: no answer within {timeout:g} s")
    if isinstance(error, socket.gaierror):
        return otherwise(f"{doing}: no such host ({error.strerror})")
    if isinstance(error, ConnectionRefusedError):
        return otherwise(f"{doing}: connection refused; is the controller on, and is the port right?")
    if error.errno in (errno.EBADF, errno.ENOTSOCK):  # ENOTSOCK on Windows
        return otherwise(f"{doing}: closed by this program")
    return otherwise(f"{doing}: {error.strerror or error}")

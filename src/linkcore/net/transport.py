"""Sources of bytes: a TCP connection with deadlines.

A transport is opened, asked for bytes until it raises, closed, and opened again. What it raises is always of this
library's error tree: errors of the operating system are mapped here and nowhere else.

What has been given up must not arrive later. TCP by itself does the opposite: what `send` handed to the kernel is
retransmitted for minutes, also after `close` and after the end of the process (Linux: `tcp_retries2`, some 15 minutes),
and arrives when the network is back. A robot would then carry out a motion whose call raised long ago, since it had
failed. Three settings prevent that:

- `SO_LINGER` of 0 s from the first moment on: whatever ends the connection, `abort`, a lost process or the garbage
  collector, the kernel discards what it holds and resets the connection (tcp(7), RFC 1122 section 4.2.2.13).
- `close` is orderly: it first waits, for a bounded time, until the peer's kernel has acknowledged everything.
- `TCP_USER_TIMEOUT` (RFC 5482; Linux): the kernel ends the connection by itself where nothing is acknowledged for as
  long as the peer may be silent. It works while this process is suspended or held up, and no thread could call `abort`.
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
from ..errors import ConnectFailed, ConnectionLost, LinkError, LinkTimeout, LocalError, RemoteError, unraised
from ..pending_call import check_wanted, interruptible
from ..process import HomeProcess

if sys.platform == "linux":
    import fcntl
    import termios

#: Bytes asked for at a time: some 60 packets, when the reader has fallen behind.
_CHUNK = 65536

#: Seconds that `close` waits for acknowledgements: a stop may be among what the peer has not. Linux delays one by up to
#: 40 ms; the rest is for two retransmissions, which Linux makes 200 and 600 ms after the first try at the earliest.
_DRAIN = 0.7

#: Seconds after which a sender that waits for room looks whether it was closed here: not every system's poll can tell.
_SLICE = 0.05

#: A NamedTuple made without its own `__new__`, which is a call of Python code for each packet.
_new_stamp = tuple.__new__


class Finished(Exception):
    """There are no more bytes, in good order: the end of a recording."""


class Transport(Protocol):
    """A source of bytes."""

    #: what it is connected to, for messages
    name: str

    @property
    def round_trip(self) -> float:
        """Seconds that the handshake of the last connection took, there and back; `inf` where there was none."""

    def open(self, timeout: float) -> None:
        """Connect within `timeout` seconds; raises `RemoteError`."""

    def receive(self, timeout: float | None = None) -> tuple[bytes, Stamp]:
        """Wait for bytes, at most `timeout` seconds; with the moment they came.

        Raises `LinkTimeout`, `ConnectionLost` or `Finished`.
        """

    def send(self, data: bytes, timeout: float) -> None:
        """Send all of `data` within `timeout` seconds; raises `RemoteError`."""

    def send_some(self, data: bytes | memoryview) -> int:
        """Hand over what is taken at once; its number of bytes. Never waits; raises `ConnectionLost`."""

    def wait_for_room(self, timeout: float) -> bool:
        """Wait until `send_some` can send something; False when time is up; raises `ConnectionLost`."""

    def abort(self) -> None:
        """Disconnect at once, discard what was not delivered, wake threads that wait. Idempotent, from any thread."""

    def close(self) -> None:
        """Disconnect once what was sent is delivered, in bounded time; then as `abort`."""


class TcpTransport:
    """A TCP connection that this side makes by `open`, or one that a peer made to it, by `adopt`.

    Args:
        host: name or address.
        port: TCP port.
        silence: seconds without a byte after which `receive` raises `LinkTimeout`, and without an acknowledgement after
            which the kernel gives the connection up.
        refused: what to say beside the error where the connection is refused, such as which setting may be the cause;
            "" for nothing.

    Attributes:
        round_trip: see `Transport`.
    """

    def __init__(self, host: str, port: int, *, silence: float, refused: Callable[[], str] = str) -> None:
        self.host = host
        self.port = port
        self.silence = silence
        self.name = f"{host}:{port}"
        self.round_trip = math.inf
        self._refused = refused
        self._home = HomeProcess(self.name)
        self._socket: socket.socket | None = None
        self._receive_timeout = silence  # that of the socket

    def another(self) -> TcpTransport:
        """A transport to the same port, which is not connected."""
        return TcpTransport(self.host, self.port, silence=self.silence, refused=self._refused)

    def open(self, timeout: float) -> None:
        """Connect within `timeout` seconds.

        Raises:
            ConnectFailed: refused, unreachable, or no such host.
            LinkTimeout: no answer in time.
            LocalError: in a process that was forked from the one which made the transport. So is every other use there.
            Cancelled: as `send_some`.
        """
        self._home.check()
        self.abort()
        try:
            connection, self.round_trip = _connected(self.host, self.port, timeout)
        except (OSError, ValueError) as error:
            raise self.failure(error, timeout) from error
        self.adopt(connection, ConnectFailed)

    def failure(self, error: OSError | ValueError, timeout: float) -> RemoteError:
        """What to raise where a connection could not be made within `timeout` seconds."""
        failure = mapped(error, f"cannot connect to {self.name}", timeout, ConnectFailed)
        hint = self._refused() if isinstance(error, ConnectionRefusedError) else ""
        return ConnectFailed(f"{failure}; {hint}") if hint else failure

    def adopt(self, connection: socket.socket, otherwise: type[RemoteError] = ConnectionLost) -> None:
        """Use a socket that is connected.

        Raises:
            otherwise: it is gone already, and closed now.
        """
        try:
            _prepare(connection, self.silence)
        except OSError as error:
            connection.close()
            raise mapped(error, self.name, self.silence, otherwise) from error
        self._receive_timeout = self.silence
        self._socket = connection if _witness is None else _witness(self, connection)
        _connections.add(self)

    def receive(self, timeout: float | None = None) -> tuple[bytes, Stamp]:
        """Wait for bytes; with the moment they came.

        Args:
            timeout: seconds to wait for the first of them; by default `silence`.

        Raises:
            LinkTimeout: nothing came in that time, although this thread was there to receive it: the kernel waited.
            ConnectionLost: the peer closed or reset the connection, `close` or `abort` was called, or the kernel gave
                it up because nothing was acknowledged.
        """
        connection = self._socket
        if connection is None:
            raise self._unconnected()
        if timeout is None:
            timeout = self.silence
        try:
            if timeout != self._receive_timeout:
                self._set_receive_timeout(connection, max(timeout, 0.0))
            data = connection.recv(_CHUNK)
        except BlockingIOError:
            raise LinkTimeout(f"{self.name}: nothing within {max(timeout, 0.0):g} s") from None
        except OSError as error:
            raise mapped(error, self.name, timeout, ConnectionLost) from error
        if not data:
            raise self._ended(connection)
        return data, _new_stamp(Stamp, (clock.read(), time.time()))

    def fileno(self) -> int:
        """The descriptor of the socket, for those who wait for many at once; -1 if there is none."""
        connection = self._socket
        return -1 if connection is None else connection.fileno()

    def receive_waiting(self) -> tuple[bytes, Stamp] | None:
        """The bytes that have come already, or None; never waits.

        Raises:
            ConnectionLost: the peer closed or reset the connection, or it was closed here.
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
        # One percent more is not worth a system call for each packet, where the timeout is what a deadline leaves.
        if not 0.99 * self._receive_timeout <= timeout <= self._receive_timeout:
            _set_receive_timeout(connection, timeout)
            self._receive_timeout = timeout

    def _ended(self, connection: socket.socket) -> ConnectionLost:
        by = "closed the connection" if self._socket is connection else "was closed here"
        return ConnectionLost(f"{self.name} {by}")

    def send(self, data: bytes, timeout: float) -> None:
        """Send all of `data` within `timeout` seconds: hand it to the kernel.

        Raises:
            LinkTimeout: the peer did not take it in time; part of it may have been sent.
            ConnectionLost: the connection is gone.
        """
        until = clock.now() + timeout
        rest = memoryview(data)
        while rest:
            sent = self.send_some(rest)
            rest = rest[sent:]
            if not sent and not self.wait_for_room(until - clock.now()):
                raise LinkTimeout(f"sending to {self.name}: nothing within {timeout:g} s")

    def send_some(self, data: bytes | memoryview) -> int:
        """Hand as much of `data` to the kernel as it takes at once, and say how many bytes that is; never waits.

        Raises:
            ConnectionLost: the connection is gone.
            Cancelled: this thread makes a call that was given up; see `linkcore.pending_call`.
        """
        connection = self._socket
        if connection is None:
            raise self._unconnected()
        check_wanted()
        # The socket blocks, for the sake of `receive`: where a send has no flag for not waiting, ask for room first.
        flags = getattr(socket, "MSG_DONTWAIT", 0)
        try:
            if not flags and not _has_room(connection, 0.0):
                return 0
            return connection.send(data, flags)
        except BlockingIOError:  # there is no room, or another thread has just taken it
            return 0
        except OSError as error:
            raise mapped(error, f"sending to {self.name}", 0.0, ConnectionLost) from error

    def wait_for_room(self, timeout: float) -> bool:
        """Wait until `send_some` can send something; False when time is up.

        Raises:
            ConnectionLost: the connection is gone.
            Cancelled: as `send_some`.
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
        raise ConnectionLost(f"sending to {self.name}: closed here")

    def abort(self) -> None:
        """Disconnect at once: the kernel discards what the peer has not acknowledged. Wakes who receives or sends."""
        connection, self._socket = self._socket, None
        if connection is None:
            return
        # Not SHUT_RDWR: that would put the end of the stream behind the bytes to be discarded, and have both delivered.
        with contextlib.suppress(OSError):  # already disconnected: no thread waits on it then
            connection.shutdown(socket.SHUT_RD)
        connection.close()

    def close(self, timeout: float = _DRAIN) -> None:
        """Disconnect when the peer's kernel has acknowledged all that was sent; after `timeout` seconds as `abort`.

        `receive` goes on meanwhile. Where the operating system does not say what is acknowledged (Linux and macOS do,
        Windows does not), it closes at once and the kernel goes on delivering: `abort` what must not arrive any more.
        """
        for pause in self.closing(timeout):
            clock.sleep(pause)

    def closing(self, timeout: float = _DRAIN) -> Iterator[float]:
        """What `close` does, step by step: seconds to wait before the next one. To be used up, or `abort`."""
        connection = self._socket
        if connection is None:
            return
        with contextlib.suppress(OSError, ValueError):  # ended by the peer, or by `abort` in another thread
            connection.shutdown(socket.SHUT_WR)  # another thread that sends gets an error from now on
            until = clock.now() + timeout
            # An acknowledgement takes some 50 us on a local network, and up to 40 ms where it is delayed.
            pause = 0.0002
            # Nothing is added meanwhile. The FIN, which need not be waited for, counts as one byte.
            while (is_under_way := _unacknowledged(connection) > 1) and clock.now() < until:
                yield pause
                pause = min(2 * pause, 0.01)
            if not is_under_way:
                connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _LINGER.pack(0, 0))
        self.abort()


#: Gets each socket that is connected, and returns what is used in its place.
_witness: Callable[[TcpTransport, Any], Any] | None = None


@contextlib.contextmanager
def witnessed(witness: Callable[[TcpTransport, Any], Any]) -> Iterator[None]:
    """Let a witness see every connection of this process that is made within the block.

    Args:
        witness: gets the transport and its socket, in the thread that has connected; returns what the transport is to
            use, such as an object that notes what passes and hands it on.
    """
    global _witness
    before, _witness = _witness, witness
    try:
        yield
    finally:
        _witness = before


#: The transports that are connected.
_connections: weakref.WeakSet[TcpTransport] = weakref.WeakSet()


def _leave_to_parent() -> None:
    """Run in a forked child: close its copies of the sockets, so that nothing it calls ends the parent's connections.

    A copy that stayed open would also keep the kernel from ending a connection that the parent closes.
    """
    for transport in list(_connections):
        connection, transport._socket = transport._socket, None
        if connection is not None:
            connection.close()


if hasattr(os, "register_at_fork"):  # not on Windows, which cannot fork
    os.register_at_fork(after_in_child=_leave_to_parent)


def _connected(host: str, port: int, timeout: float) -> tuple[socket.socket, float]:
    """A connection to the first address of `host` that answers, and the s of its handshake.

    `timeout` is for all of them together.
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
        failure = None  # the error refers to this frame


def _interrupt(connection: socket.socket) -> None:
    """End the wait of another thread that connects this socket; outside Linux the wait may last until its timeout."""
    with contextlib.suppress(OSError):
        connection.shutdown(socket.SHUT_RDWR)


#: struct linger: is it on, seconds. Two ints, but two shorts on Windows (winsock2.h).
_LINGER = struct.Struct("hh" if sys.platform == "win32" else "ii")


def _prepare(connection: socket.socket, silence: float) -> None:
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _LINGER.pack(1, 0))
    # A controller that lost power sends no FIN; `silence` notices sooner, keepalive frees the socket.
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    if hasattr(socket, "TCP_USER_TIMEOUT"):
        # In ms, and 0 is the system's default. `silence`, since after that this side calls the connection lost too.
        milliseconds = min(max(round(silence * 1e3), 1), 2**31 - 1)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, milliseconds)
    _set_receive_timeout(connection, silence)


def _has_room(connection: socket.socket, seconds: float) -> bool:
    """Wait until something can be sent; False when time is up.

    Raises:
        OSError: the connection ended, or was ended here.
    """
    number = connection.fileno()
    if number < 0:
        raise OSError(errno.EBADF, "closed")
    if sys.platform == "win32":
        return bool(select.select([], [connection], [], seconds)[1])
    # Not select: it takes no descriptors beyond 1023, and a program with many robots has those. While poll waits, the
    # kernel keeps the socket open, so `abort` takes effect when poll returns: POLLRDHUP makes SHUT_RD wake it (Linux).
    ended = getattr(select, "POLLRDHUP", 0)
    poll = select.poll()
    poll.register(number, select.POLLOUT | ended)
    events = sum(mask for _, mask in poll.poll(seconds * 1e3))
    if events & ended and not events & select.POLLOUT:
        raise OSError(errno.EPIPE, "the connection ended")
    return bool(events)


def _unacknowledged(connection: socket.socket) -> int:
    """Bytes that were sent and not acknowledged, and one for the FIN; 0 where the system does not tell."""
    if sys.platform == "linux":
        # SIOCOUTQ has the number of TIOCOUTQ (linux/sockios.h).
        (count,) = struct.unpack("i", fcntl.ioctl(connection, termios.TIOCOUTQ, bytes(4)))
    elif sys.platform == "darwin":
        count = connection.getsockopt(socket.SOL_SOCKET, 0x1024)  # SO_NWRITE of sys/socket.h; not tried on a Mac
    else:
        count = 0
    return int(count)


def _set_receive_timeout(connection: socket.socket, seconds: float) -> None:
    """Let `recv` wait so long, and no longer.

    Python's own timeout asks the kernel twice for each packet, poll and recv; the kernel's asks once.
    """
    if sys.platform == "win32":
        connection.settimeout(seconds)
        return
    connection.settimeout(None)
    # struct timeval is two words of 4 or 8 bytes, and the option itself tells which. `long` would be wrong on a 32-bit
    # system whose time_t has 64 bits (Debian 13, and Raspberry Pi OS made from it): it takes two words of 8.
    size = len(connection.getsockopt(socket.SOL_SOCKET, socket.SO_RCVTIMEO, 32))
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVTIMEO, _timeval(seconds, size))


def _timeval(seconds: float, size: int) -> bytes:
    """A struct timeval of `size` bytes. Never 0, which means for ever."""
    whole = int(seconds)
    return struct.pack("qq" if size == 16 else "ii", whole, max(int((seconds - whole) * 1e6), 1))


def is_unknown_host(error: RemoteError) -> bool:
    """Whether a connection could not be made because the name of its host is unknown."""
    return isinstance(error.__cause__, (socket.gaierror, ValueError))


def mapped(error: OSError | ValueError, doing: str, timeout: float, otherwise: type[RemoteError]) -> RemoteError:
    """The one place where operating-system errors become the library's own."""
    if isinstance(error, ValueError):  # a part of the name is too long, or holds what no name may
        return otherwise(f"{doing}: no such host ({error})")
    if error.errno == errno.ETIMEDOUT and otherwise is ConnectionLost:
        # Not that nothing came: TCP_USER_TIMEOUT or keepalive has ended the connection.
        return otherwise(f"{doing}: the peer no longer acknowledges what is sent, so the connection was given up")
    if isinstance(error, TimeoutError):
        return LinkTimeout(f"{doing}: nothing within {timeout:g} s")
    if isinstance(error, socket.gaierror):
        return otherwise(f"{doing}: no such host ({error.strerror})")
    if isinstance(error, ConnectionRefusedError):
        return otherwise(f"{doing}: connection refused; is the controller on, and is this its port?")
    if error.errno == errno.EBADF:
        return otherwise(f"{doing}: closed here")
    return otherwise(f"{doing}: {error.strerror or error}")

"""Where bytes come from: TCP with deadlines. Beside it only `linkcore.net.listener` imports `socket`.

A transport is opened, asked for chunks until it raises, closed, and opened again. What it raises is
always of this library's error tree: operating-system errors are mapped here and nowhere else.
"""

from __future__ import annotations

import contextlib
import errno
import select
import socket
import struct
import sys
import time
from typing import Protocol

from ..errors import ConnectFailed, ConnectionLost, LinkTimeout, RemoteError
from ..stamp import Stamp

__all__ = ["Finished", "TcpTransport", "Transport"]

#: Bytes asked for at a time: some 60 packets, when the reader has fallen behind.
_CHUNK = 65536


class Finished(Exception):
    """There are no more bytes, in good order: the end of a recording."""


class Transport(Protocol):
    """A source of bytes."""

    #: what it is connected to, for messages
    name: str

    def open(self, timeout: float) -> None:
        """Connect within `timeout` seconds; raises `RemoteError`."""

    def receive(self) -> tuple[bytes, Stamp]:
        """Wait for bytes; with the moment they came. Raises `LinkTimeout`, `ConnectionLost` or `Finished`."""

    def send(self, data: bytes, timeout: float) -> None:
        """Send all of `data` within `timeout` seconds; raises `RemoteError`."""

    def close(self) -> None:
        """Disconnect, and wake whoever waits in `receive`. Idempotent, from any thread."""


class TcpTransport:
    """A TCP connection: as a client, or `accepted` from one.

    Args:
        host: name or address.
        port: TCP port.
        silence: seconds without a byte after which `receive` raises `LinkTimeout`.
    """

    def __init__(self, host: str, port: int, *, silence: float) -> None:
        self.host = host
        self.port = port
        self.silence = silence
        self.name = f"{host}:{port}"
        self._socket: socket.socket | None = None
        self._patience = silence  # what the socket has been told

    @classmethod
    def accepted(cls, connection: socket.socket, host: str, port: int, *, silence: float) -> TcpTransport:
        """A connection that the peer at `host` and `port` made to this side; see `linkcore.net.listener`.

        Raises:
            ConnectionLost: it is gone already.
        """
        transport = cls(host, port, silence=silence)
        try:
            _prepare(connection, silence)
        except OSError as error:
            connection.close()
            raise mapped(error, transport.name, silence, ConnectionLost) from error
        transport._socket = connection
        return transport

    def open(self, timeout: float) -> None:
        """Connect within `timeout` seconds.

        Raises:
            ConnectFailed: refused, unreachable, or no such host.
            LinkTimeout: nobody answered in time.
        """
        self.close()
        try:
            self._socket = _connected(self.host, self.port, timeout, self.silence)
            self._patience = self.silence
        except (OSError, ValueError) as error:
            raise mapped(error, f"cannot connect to {self.name}", timeout, ConnectFailed) from error

    def receive(self, timeout: float | None = None) -> tuple[bytes, Stamp]:
        """Wait for bytes; with the moment they came.

        Args:
            timeout: seconds to wait for the first of them; by default `silence`.

        Raises:
            LinkTimeout: silent for too long.
            ConnectionLost: the peer closed or reset the connection, or `close` was called.
        """
        connection = self._socket
        if connection is None:
            raise ConnectionLost(f"{self.name} is not connected")
        patience = self.silence if timeout is None else max(timeout, 0.0)
        try:
            # A hundredth more is not worth a system call for each packet, where the timeout is what a deadline leaves.
            if not 0.99 * self._patience <= patience <= self._patience:
                _set_receive_timeout(connection, patience)
                self._patience = patience
            data = connection.recv(_CHUNK)
        except BlockingIOError:
            raise LinkTimeout(f"{self.name}: nothing within {patience:g} s") from None
        except OSError as error:
            raise mapped(error, f"{self.name}", patience, ConnectionLost) from error
        return self._arrived(connection, data)

    def receive_waiting(self) -> tuple[bytes, Stamp] | None:
        """The bytes that have come already, or None; never waits.

        Raises:
            ConnectionLost: the peer closed or reset the connection, or `close` was called.
        """
        connection = self._socket
        if connection is None:
            raise ConnectionLost(f"{self.name} is not connected")
        try:
            if sys.platform == "win32":
                connection.settimeout(0)
                self._patience = 0.0
            data = connection.recv(_CHUNK, getattr(socket, "MSG_DONTWAIT", 0))
        except BlockingIOError:
            return None
        except OSError as error:
            raise mapped(error, f"{self.name}", 0.0, ConnectionLost) from error
        return self._arrived(connection, data)

    def _arrived(self, connection: socket.socket, data: bytes) -> tuple[bytes, Stamp]:
        if not data:
            by = "closed the connection" if self._socket is connection else "was closed here"
            raise ConnectionLost(f"{self.name} {by}")
        return data, Stamp(time.monotonic(), time.time())

    def send(self, data: bytes, timeout: float) -> None:
        """Send all of `data` within `timeout` seconds.

        Raises:
            LinkTimeout: the peer did not take it in time; part of it may have been sent.
            ConnectionLost: the connection is gone.
        """
        connection = self._socket
        if connection is None:
            raise ConnectionLost(f"{self.name} is not connected")
        until = time.monotonic() + timeout
        rest = memoryview(data)
        # The socket blocks, for the sake of `receive`: where a send cannot be told not to, ask for room first.
        flags = getattr(socket, "MSG_DONTWAIT", 0)
        ask = not flags
        try:
            while rest:
                if ask and not _has_room(connection, max(until - time.monotonic(), 0.0)):
                    raise TimeoutError
                try:
                    rest = rest[connection.send(rest, flags) :]
                except BlockingIOError:  # there is no room, or another thread has just taken it
                    ask = True
        except OSError as error:
            raise mapped(error, f"sending to {self.name}", timeout, ConnectionLost) from error

    def close(self) -> None:
        """Disconnect, and wake whoever waits in `receive`."""
        connection, self._socket = self._socket, None
        if connection is None:
            return
        with contextlib.suppress(OSError):  # already gone: nobody is waiting on it then
            connection.shutdown(socket.SHUT_RDWR)
        connection.close()


def _connected(host: str, port: int, timeout: float, silence: float) -> socket.socket:
    """A connection to the first address of `host` that answers; `timeout` is for all of them together."""
    until = time.monotonic() + timeout
    places = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)
    failure: OSError | None = None
    for number, (family, kind, protocol, _, address) in enumerate(places):
        left = (until - time.monotonic()) / (len(places) - number)
        connection = None
        try:
            connection = socket.socket(family, kind, protocol)
            connection.settimeout(max(left, 1e-3))
            connection.connect(address)
            _prepare(connection, silence)
        except OSError as error:
            failure = error
            if connection is not None:
                connection.close()
        except BaseException:
            if connection is not None:
                connection.close()
            raise
        else:
            return connection
    raise failure or OSError(f"{host} has no address")


def _prepare(connection: socket.socket, silence: float) -> None:
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    # A controller that lost power sends no FIN; `silence` notices sooner, keepalive frees the socket.
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    _set_receive_timeout(connection, silence)


def _has_room(connection: socket.socket, seconds: float) -> bool:
    """Wait until something can be sent; False when time is up."""
    number = connection.fileno()
    if number < 0:
        raise OSError(errno.EBADF, "closed")
    if sys.platform == "win32":
        return bool(select.select([], [connection], [], seconds)[1])
    # Not select: it takes no descriptors beyond 1023, and a program with many robots has those.
    poll = select.poll()
    poll.register(number, select.POLLOUT)
    return bool(poll.poll(seconds * 1e3))


def _set_receive_timeout(connection: socket.socket, seconds: float) -> None:
    """Let `recv` wait so long, and no longer.

    Python's own timeout asks the kernel twice for each packet, poll and recv; the kernel's asks once.
    """
    if sys.platform == "win32":
        connection.settimeout(seconds)
        return
    connection.settimeout(None)
    whole = int(seconds)
    connection.setsockopt(
        socket.SOL_SOCKET, socket.SO_RCVTIMEO, struct.pack("ll", whole, max(int((seconds - whole) * 1e6), 1))
    )


def mapped(error: OSError | ValueError, doing: str, timeout: float, otherwise: type[RemoteError]) -> RemoteError:
    """The one place where operating-system errors become the library's own."""
    if isinstance(error, ValueError):  # a part of the name is too long, or holds what no name may
        return otherwise(f"{doing}: no such host ({error})")
    if isinstance(error, TimeoutError):
        return LinkTimeout(f"{doing}: nothing within {timeout:g} s")
    if isinstance(error, socket.gaierror):
        return otherwise(f"{doing}: no such host ({error.strerror})")
    if isinstance(error, ConnectionRefusedError):
        return otherwise(f"{doing}: connection refused; is the controller on, and is this its port?")
    if error.errno == errno.EBADF:
        return otherwise(f"{doing}: closed here")
    return otherwise(f"{doing}: {error.strerror or error}")

"""TCP connections for programs that use asyncio. Opening and closing them does not block the event loop."""

from __future__ import annotations

import asyncio
import contextlib
import errno
import os
import socket
from functools import partial
from typing import Any, Protocol

from .. import clock
from ..clock import Stamp
from ..errors import ConnectFailed, LinkTimeout, unraised
from ..event_loop import happened, within
from .transport import TcpTransport, Transport
from .watching import forget, watch

#: Results of a non-blocking `connect` that is still in progress; 10035 is WSAEWOULDBLOCK of Windows.
_IN_PROGRESS = (errno.EINPROGRESS, errno.EWOULDBLOCK, 10035)


class AwaitedTransport(Transport, Protocol):
    """Transport for whose bytes an event loop can wait."""

    async def connect(self, timeout: float) -> None:
        """Connect like `open`, without blocking the event loop."""

    def fileno(self) -> int:
        """Return the descriptor that becomes readable when bytes arrive.

        Return -1 if there is no connection.
        """

    def receive_waiting(self) -> tuple[bytes, Stamp] | None:
        """Return the bytes that have already arrived, or None. Never waits. Raises `ConnectionLost`."""

    async def disconnect(self) -> None:
        """Disconnect like `close`, without blocking the event loop."""


class AwaitedTcp(TcpTransport):
    """TCP connection for whose bytes an event loop can wait."""

    async def connect(self, timeout: float) -> None:
        """Connect within `timeout` seconds. If the call is cancelled, everything is closed.

        Raises:
            ConnectFailed: If the connection is refused, or the host is unreachable or unknown.
            LinkTimeout: If the host does not answer in time.
            LocalError: If the loop needs a thread to wait for sockets, and the system refuses another thread.
        """
        self.abort()
        try:
            connection, self.round_trip = await _connected(self.host, self.port, timeout)
        except (OSError, ValueError) as error:
            raise self.failure(error, timeout) from error
        self.adopt(connection, ConnectFailed)

    async def receive_awaited(self, timeout: float) -> tuple[bytes, Stamp]:
        """Wait for bytes; return them with the time of their arrival.

        Do not call this while the loop watches the descriptor for another reader.

        Raises:
            LinkTimeout: If nothing arrives in time.
            ConnectionLost: If the peer closes or resets the connection, or this program closes it.
            LocalError: If the loop needs a thread to wait for sockets, and the system refuses another thread.
        """
        until = clock.now() + timeout
        while (received := self.receive_waiting()) is None:
            if not await _is_ready(self.fileno(), until - clock.now()):
                raise LinkTimeout(f"{self.name}: nothing received within {timeout:g} s")
        return received

    async def disconnect(self) -> None:
        """Disconnect when the operating system of the peer has acknowledged all sent data.

        See `TcpTransport.close`.
        """
        try:
            for pause in self.closing():
                await asyncio.sleep(pause)
        finally:
            self.abort()


async def _is_ready(descriptor: int, seconds: float, *, for_room: bool = False) -> bool:
    """Wait until bytes have arrived, or with `for_room`, until bytes can be sent. Return False after `seconds`."""
    loop = asyncio.get_running_loop()
    ready: asyncio.Future[None] = loop.create_future()
    watch(loop, descriptor, lambda: happened(ready), for_room=for_room)
    try:
        return await within(max(seconds, 0.0), ready)
    finally:
        forget(loop, descriptor, for_room=for_room)


async def _connected(host: str, port: int, timeout: float) -> tuple[socket.socket, float]:
    """Return a connection to the first address of `host` that answers, and the duration of its handshake in s.

    `timeout` is the maximum time for all addresses together.
    """
    until = clock.now() + timeout
    failure: Exception | None = None
    places = await _addresses(host, port, timeout)
    for number, (family, kind, protocol, _, address) in enumerate(places):
        left = (until - clock.now()) / (len(places) - number)
        try:
            connection = socket.socket(family, kind, protocol)
        except OSError as error:  # this computer does not support the address family
            failure = unraised(error)
            continue
        try:
            began = clock.now()
            await _connect(connection, address, max(left, 1e-3))
            round_trip = clock.now() - began
        except OSError as error:
            failure = unraised(error)
            connection.close()
        except BaseException:
            connection.close()
            raise
        else:
            return connection, round_trip
    try:
        raise failure or OSError(f"{host} has no address")
    finally:
        failure = None  # breaks the reference cycle between the error and this frame


async def _connect(connection: socket.socket, address: Any, seconds: float) -> None:
    """Connect like `loop.sock_connect`, but without a separate task that might keep the descriptor after a cancel."""
    connection.setblocking(False)
    error = connection.connect_ex(address)
    if error in _IN_PROGRESS:
        if not await _is_ready(connection.fileno(), seconds, for_room=True):
            raise TimeoutError
        error = connection.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR)
    if error:
        raise OSError(error, os.strerror(error))


async def _addresses(host: str, port: int, timeout: float) -> list[Any]:
    with contextlib.suppress(OSError):  # `host` is a name
        return socket.getaddrinfo(host, port, type=socket.SOCK_STREAM, flags=socket.AI_NUMERICHOST)
    # The system's resolver blocks, so a thread of the loop calls it. An answer that arrives too late is dropped.
    loop = asyncio.get_running_loop()
    asked = loop.run_in_executor(None, partial(socket.getaddrinfo, host, port, type=socket.SOCK_STREAM))
    try:
        if await within(timeout, asked):
            return asked.result()
    finally:
        if not asked.cancel():
            asked.exception()  # reading the exception prevents asyncio from logging it if the task is cancelled
    raise TimeoutError

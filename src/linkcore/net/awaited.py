"""TCP connections for programs that use asyncio: opened and closed without blocking the event loop."""

from __future__ import annotations

import asyncio
import contextlib
import errno
import os
import socket
from collections.abc import Callable
from functools import partial
from typing import Any, Protocol

from .. import clock
from ..clock import Stamp
from ..errors import ConnectFailed, LinkTimeout, LocalError, unraised
from ..event_loop import happened, within
from .transport import TcpTransport, Transport

#: What a connection that does not wait answers while it is made; 10035 is WSAEWOULDBLOCK, of Windows.
_IN_PROGRESS = (errno.EINPROGRESS, errno.EWOULDBLOCK, 10035)


class AwaitedTransport(Transport, Protocol):
    """A source of bytes that an event loop can wait for."""

    async def connect(self, timeout: float) -> None:
        """As `open`; while other things go on."""

    def fileno(self) -> int:
        """The descriptor that is readable when bytes have come; -1 while there is no connection."""

    def receive_waiting(self) -> tuple[bytes, Stamp] | None:
        """The bytes that have come already, or None; never waits; raises `ConnectionLost`."""

    async def disconnect(self) -> None:
        """As `close`; while other things go on."""


class AwaitedTcp(TcpTransport):
    """A TCP connection that an event loop waits for."""

    async def connect(self, timeout: float) -> None:
        """Connect within `timeout` seconds. Given up, nothing is left of it.

        Raises:
            ConnectFailed: refused, unreachable, or no such host.
            LinkTimeout: no answer in time.
            LocalError: the loop cannot wait for sockets.
        """
        self.abort()
        try:
            connection, self.round_trip = await _connected(self.host, self.port, timeout)
        except (OSError, ValueError) as error:
            raise self.failure(error, timeout) from error
        self.adopt(connection, ConnectFailed)

    async def receive_awaited(self, timeout: float) -> tuple[bytes, Stamp]:
        """Wait for bytes; with the moment they came. Not while the loop watches the descriptor for somebody else.

        Raises:
            LinkTimeout: nothing came in that time.
            ConnectionLost: the peer closed or reset the connection, or it was closed here.
            LocalError: the loop cannot wait for sockets.
        """
        until = clock.now() + timeout
        while (received := self.receive_waiting()) is None:
            if not await _is_ready(self.fileno(), until - clock.now()):
                raise LinkTimeout(f"{self.name}: nothing within {timeout:g} s")
        return received

    async def disconnect(self) -> None:
        """Disconnect when the peer's kernel has acknowledged what was sent; see `TcpTransport.close`."""
        try:
            for pause in self.closing():
                await asyncio.sleep(pause)
        finally:
            self.abort()


def watch(
    loop: asyncio.AbstractEventLoop, descriptor: int, callback: Callable[[], object], *, for_room: bool = False
) -> None:
    """Have the loop call when bytes have come; with `for_room`, when there is room to send.

    Raises:
        LocalError: such a loop cannot.
    """
    try:
        (loop.add_writer if for_room else loop.add_reader)(descriptor, callback)
    except NotImplementedError:
        raise LocalError(
            f"{type(loop).__name__} cannot wait for sockets; on Windows run the program with "
            "asyncio.SelectorEventLoop, which can"
        ) from None


async def _is_ready(descriptor: int, seconds: float, *, for_room: bool = False) -> bool:
    """Wait until bytes have come, or there is room; False when time is up."""
    loop = asyncio.get_running_loop()
    ready: asyncio.Future[None] = loop.create_future()
    watch(loop, descriptor, lambda: happened(ready), for_room=for_room)
    try:
        return await within(max(seconds, 0.0), ready)
    finally:
        (loop.remove_writer if for_room else loop.remove_reader)(descriptor)


async def _connected(host: str, port: int, timeout: float) -> tuple[socket.socket, float]:
    """A connection to the first address of `host` that answers, and the s of its handshake.

    `timeout` is for all of them together.
    """
    until = clock.now() + timeout
    failure: Exception | None = None
    places = await _addresses(host, port, timeout)
    for number, (family, kind, protocol, _, address) in enumerate(places):
        left = (until - clock.now()) / (len(places) - number)
        try:
            connection = socket.socket(family, kind, protocol)
        except OSError as error:  # this computer lacks the family
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
        failure = None  # the error refers to this frame


async def _connect(connection: socket.socket, address: Any, seconds: float) -> None:
    """As `loop.sock_connect`, in no task of its own: cancelled, nothing is left that has the descriptor."""
    connection.setblocking(False)
    error = connection.connect_ex(address)
    if error in _IN_PROGRESS:
        if not await _is_ready(connection.fileno(), seconds, for_room=True):
            raise TimeoutError
        error = connection.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR)
    if error:
        raise OSError(error, os.strerror(error))


async def _addresses(host: str, port: int, timeout: float) -> list[Any]:
    with contextlib.suppress(OSError):  # it is a name
        return socket.getaddrinfo(host, port, type=socket.SOCK_STREAM, flags=socket.AI_NUMERICHOST)
    # The system's resolver waits, so a thread of the loop's own asks it; what it answers too late is dropped.
    loop = asyncio.get_running_loop()
    asked = loop.run_in_executor(None, partial(socket.getaddrinfo, host, port, type=socket.SOCK_STREAM))
    try:
        if await within(timeout, asked):
            return asked.result()
    finally:
        if not asked.cancel():
            asked.exception()  # read, or asyncio would log it where the task is cancelled
    raise TimeoutError

"""TCP connections for programs that use asyncio: made and ended while other things go on."""

from __future__ import annotations

import asyncio
import contextlib
import socket
from collections.abc import Callable
from typing import Any, Protocol

from ..errors import ConnectFailed, LinkTimeout, LocalError
from ..stamp import Stamp
from .transport import TcpTransport, Transport

__all__ = ["AwaitedTcp", "AwaitedTransport", "watch"]


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
        """
        self.abort()
        try:
            connection = await _connected(self.host, self.port, timeout)
        except asyncio.TimeoutError:  # not a TimeoutError before 3.11
            raise LinkTimeout(f"cannot connect to {self.name}: nothing within {timeout:g} s") from None
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
        loop = asyncio.get_running_loop()
        until = loop.time() + timeout
        while (received := self.receive_waiting()) is None:
            readable: asyncio.Future[None] = loop.create_future()
            descriptor = self.fileno()
            watch(loop, descriptor, lambda readable=readable: readable.done() or readable.set_result(None))  # type: ignore[misc]
            try:
                await asyncio.wait_for(readable, max(until - loop.time(), 0.0))
            except asyncio.TimeoutError:
                raise LinkTimeout(f"{self.name}: nothing within {timeout:g} s") from None
            finally:
                loop.remove_reader(descriptor)
        return received

    async def disconnect(self) -> None:
        """Disconnect when the peer's kernel has acknowledged what was sent; see `TcpTransport.close`."""
        try:
            for pause in self.closing():
                await asyncio.sleep(pause)
        finally:
            self.abort()


def watch(loop: asyncio.AbstractEventLoop, descriptor: int, callback: Callable[[], object]) -> None:
    """Have the loop call when bytes have come.

    Raises:
        LocalError: such a loop cannot.
    """
    try:
        loop.add_reader(descriptor, callback)
    except NotImplementedError:
        raise LocalError(
            f"{type(loop).__name__} cannot wait for sockets; on Windows run the program with "
            "asyncio.SelectorEventLoop, which can"
        ) from None


async def _connected(host: str, port: int, timeout: float) -> socket.socket:
    """A connection to the first address of `host` that answers; `timeout` is for all of them together."""
    loop = asyncio.get_running_loop()
    until = loop.time() + timeout
    failure: Exception | None = None
    places = await asyncio.wait_for(_addresses(host, port), timeout)
    for number, (family, kind, protocol, _, address) in enumerate(places):
        left = (until - loop.time()) / (len(places) - number)
        connection = socket.socket(family, kind, protocol)
        try:
            connection.setblocking(False)
            await asyncio.wait_for(loop.sock_connect(connection, address), max(left, 1e-3))
        except (OSError, asyncio.TimeoutError) as error:
            failure = error
            connection.close()
        except BaseException:
            connection.close()
            raise
        else:
            return connection
    raise failure or OSError(f"{host} has no address")


async def _addresses(host: str, port: int) -> list[Any]:
    with contextlib.suppress(OSError):  # it is a name
        return socket.getaddrinfo(host, port, type=socket.SOCK_STREAM, flags=socket.AI_NUMERICHOST)
    # The system's resolver waits, so asyncio asks it in a thread of its own.
    return await asyncio.get_running_loop().getaddrinfo(host, port, type=socket.SOCK_STREAM)

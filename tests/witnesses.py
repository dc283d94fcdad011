"""Access to the sockets of connections, to read their options and wait for their data without taking it."""

from __future__ import annotations

import contextlib
import socket
from collections.abc import Iterator

from linkcore.net.transport import TcpTransport, witnessed

__all__ = ["sockets_made"]


@contextlib.contextmanager
def sockets_made() -> Iterator[list[socket.socket]]:
    """Collect the sockets of the connections that are made within the block."""
    made: list[socket.socket] = []

    def witness(transport: TcpTransport, connection: socket.socket) -> socket.socket:
        made.append(connection)
        return connection

    with witnessed(witness):
        yield made

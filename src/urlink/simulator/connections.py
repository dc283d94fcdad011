"""A port of the controller, and the connections to it: their sockets, and the lines that clients send."""

from __future__ import annotations

import contextlib
import socket
import struct
from typing import TYPE_CHECKING

from linkcore.errors import BadAddress

from ..ports import interface
from .assembly import Assembler

if TYPE_CHECKING:
    from .tampering import Segmenter

__all__ = ["Client", "Port"]

#: Bytes of a line from a client; longer ones are thrown away.
LONGEST_LINE = 1 << 16

# Bytes that the kernel may hold for a client. Left to itself it grows to megabytes: seconds of old news.
_KERNEL_BUFFER = 1 << 18
# Closing with this option set resets the connection.
_RESET = struct.pack("ii", 1, 0)


class Port:
    """One port: its listening socket and its clients.

    While the controller is down the socket is bound and does not listen: connections are refused, and nobody else can
    take the number.

    Args:
        name: one of `PORTS`.
        host: address to listen on.
        number: 0 for a free one.

    Attributes:
        kind: name of the interface that it serves.
        clients: connected at present.
        is_listening: the controller is up.
        is_paused: the port is stalled and somebody waits to be accepted.

    Raises:
        BadAddress: it cannot be listened on.
    """

    def __init__(self, name: str, host: str, number: int) -> None:
        self.name = name
        self.kind = interface(name)
        self.clients: set[Client] = set()
        self._host = host
        self.socket = self._bound(number)
        self.number: int = self.socket.getsockname()[1]
        self.is_listening = False
        self.is_paused = False

    def _bound(self, number: int) -> socket.socket:
        listener = None
        try:
            family, kind, protocol, _, address = socket.getaddrinfo(self._host, number, type=socket.SOCK_STREAM)[0]
            listener = socket.socket(family, kind, protocol)
            listener.setblocking(False)
            listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            listener.bind(address)
        except (OSError, OverflowError) as error:
            if listener is not None:
                listener.close()
            reason = getattr(error, "strerror", None) or error
            raise BadAddress(f"cannot listen on {self._host}:{number} for {self.name}: {reason}") from None
        return listener

    def listen(self) -> None:
        """Let clients come."""
        self.socket.listen(64)
        self.is_listening = True

    def refuse(self) -> None:
        """Let nobody come until `listen`."""
        self.socket.close()
        self.socket = self._bound(self.number)
        self.is_listening = self.is_paused = False

    def accept(self) -> Client | None:
        """Who came; None if it is gone again."""
        try:
            link, address = self.socket.accept()
        except OSError:
            return None
        link.setblocking(False)
        link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        link.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _KERNEL_BUFFER)
        client = Client(link, self, address[0])
        self.clients.add(client)
        return client


class Client:
    """One connection: what waits to be sent, and the line that is being received.

    Attributes:
        peer: numeric address of the client.
        pending: bytes that the network did not take yet.
        assembler: makes programs of its lines.
        segmenter: of what is sent, or None where packets are sent as they are.
    """

    def __init__(self, link: socket.socket, port: Port, peer: str) -> None:
        self.link = link
        self.port = port
        self.peer = peer
        self.is_open = True
        self.pending = bytearray()
        self.assembler = Assembler()
        self.segmenter: Segmenter | None = None
        self._line = bytearray()
        self._is_too_long = False

    def extend_line(self, part: bytes) -> int:
        """More of the line that is being received. How many bytes were thrown away because it is too long."""
        if self._is_too_long or len(self._line) + len(part) > LONGEST_LINE:
            refused = len(self._line) + len(part)
            self._line.clear()
            self._is_too_long = True
            return refused
        self._line += part
        return 0

    def end_line(self) -> str | None:
        """The line, now that it is whole; None if it was too long."""
        text = None if self._is_too_long else self._line.decode("utf-8", "backslashreplace").removesuffix("\r")
        self._line.clear()
        self._is_too_long = False
        return text

    def close(self, reset: bool = False) -> None:
        """End the connection."""
        self.is_open = False
        self.port.clients.discard(self)
        if reset:
            with contextlib.suppress(OSError):
                self.link.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _RESET)
        self.link.close()

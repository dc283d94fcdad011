"""Waiting for a peer to connect to this side, and the address at which it can.

What a controller needs whose program talks back: the program is told `local_address` and the port of a `TcpListener`.
"""

from __future__ import annotations

import contextlib
import socket

from ..errors import BadAddress, ConnectFailed, ConnectionLost, LinkTimeout
from .transport import TcpTransport, mapped

__all__ = ["TcpListener", "addresses", "local_address"]

#: Seconds without a byte after which a connection that was accepted counts as silent, where nobody says otherwise.
_SILENCE = 2.0


class TcpListener:
    """A port that takes connections. A context manager that closes itself.

    Args:
        host: address of this computer to listen on; "" for all of them.
        port: 0 for one that is free.

    Attributes:
        address: (host, port) that it listens on.

    Raises:
        BadAddress: nobody can listen there: taken, not an address of this computer, no such port.
    """

    def __init__(self, host: str, port: int = 0) -> None:
        if not 0 <= port <= 65535:  # which getaddrinfo would take modulo 65536
            raise BadAddress(f"cannot listen on {host or '*'}:{port}: expected a port from 0 to 65535")
        listener = None
        try:
            places = socket.getaddrinfo(host or None, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)
            # Without a host the robot is expected on IPv4, which is all that its programs can open a socket to.
            family, kind, protocol, _, address = min(places, key=lambda place: place[0] != socket.AF_INET)
            listener = socket.socket(family, kind, protocol)
            if hasattr(socket, "SO_EXCLUSIVEADDRUSE"):  # Windows, where SO_REUSEADDR would let others take the port
                listener.setsockopt(socket.SOL_SOCKET, socket.SO_EXCLUSIVEADDRUSE, 1)
            else:
                listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            listener.bind(address)
            listener.listen(1)
        except (OSError, ValueError) as error:
            if listener is not None:
                listener.close()
            reason = getattr(error, "strerror", None) or error
            raise BadAddress(f"cannot listen on {host or '*'}:{port}: {reason}") from error
        self._socket: socket.socket | None = listener
        bound = listener.getsockname()
        self.address: tuple[str, int] = (bound[0], bound[1])

    def accept(self, timeout: float, *, silence: float = _SILENCE) -> TcpTransport:
        """The next connection, made within `timeout` seconds; 0 takes one that is there already.

        Raises:
            LinkTimeout: nobody came.
            ConnectFailed: the listener was closed.
            ConnectionLost: whoever came is gone again.
        """
        listener = self._socket
        where = f"{self.address[0]}:{self.address[1]}"
        if listener is None:
            raise ConnectFailed(f"{where} is not listened on any more")
        try:
            listener.settimeout(max(timeout, 0.0))
            connection, peer = listener.accept()
        except BlockingIOError:
            raise LinkTimeout(f"nobody connected to {where} yet") from None
        except TimeoutError:
            raise LinkTimeout(f"nobody connected to {where} within {timeout:g} s") from None
        except ConnectionError as error:
            raise mapped(error, f"a connection to {where}", timeout, ConnectionLost) from error
        except OSError as error:
            raise mapped(error, f"waiting on {where}", timeout, ConnectFailed) from error
        return TcpTransport.accepted(connection, peer[0], peer[1], silence=silence)

    def close(self) -> None:
        """Listen no longer, and wake whoever waits in `accept`. Idempotent; what was accepted stays."""
        listener, self._socket = self._socket, None
        if listener is None:
            return
        with contextlib.suppress(OSError):  # systems that cannot shut a listening socket down wake by closing
            listener.shutdown(socket.SHUT_RDWR)
        listener.close()

    def __enter__(self) -> TcpListener:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()


def addresses(host: str) -> frozenset[str]:
    """The numeric addresses of a host, as `TcpListener.accept` names a peer that connects from there.

    Raises:
        ConnectFailed: no such host.
    """
    try:
        places = socket.getaddrinfo(host, None, type=socket.SOCK_STREAM)
    except (OSError, ValueError) as error:
        raise mapped(error, f"cannot find {host}", 0.0, ConnectFailed) from error
    return frozenset(str(place[4][0]) for place in places)


def local_address(host: str) -> str:
    """The address of this computer on the route to `host`. Nothing is sent.

    Raises:
        ConnectFailed: no such host, or no route to it.
    """
    # Connecting a datagram socket only chooses the route; the port does not matter.
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(host, 9, type=socket.SOCK_DGRAM)[0]
        with socket.socket(family, kind, protocol) as probe:
            probe.connect(address)
            here: str = probe.getsockname()[0]
    except (OSError, ValueError) as error:
        raise mapped(error, f"cannot find the route to {host}", 0.0, ConnectFailed) from error
    return here

"""Listening sockets, and the class `TcpListener`, which waits for a single peer.

All listening sockets of the project are made in this module, even those of servers with many clients:
`linkcore.net.loop` calls this module. The same rules for host names apply to every port that this project opens:

- `""` is every IPv4 address of this computer. IPv4 is sufficient, because programs of robots open sockets only to IPv4
  addresses.
- `"::"` is every address of either family (dual stack), if the system has IPv6.
- Any other address is used as it is. A host name is resolved; if it has addresses of both families, the IPv4 address is
  used.
"""

from __future__ import annotations

import contextlib
import errno
import os
import socket
import weakref

from ..errors import BadAddress, ConnectFailed, ConnectionLost, LinkTimeout
from ..process import HomeProcess
from ..threads import MadeOnce
from .transport import TcpTransport, mapped

#: Seconds without a byte after which an accepted connection is considered silent.
_SILENCE = 2.0


def bound_socket(host: str, port: int, *, purpose: str = "") -> socket.socket:
    """Return a non-blocking TCP socket that is bound but does not listen yet, so that connections are refused.

    Args:
        host: Address of this computer. See the module's description for `""` and `"::"`.
        port: TCP port; 0 for a free port.
        purpose: Purpose of the port, used in the error message.

    Raises:
        BadAddress: If the address is in use, is not an address of this computer, or has an invalid port.
    """
    where = f"{host or '*'}:{port}" + (f" for {purpose}" if purpose else "")
    if not 0 <= port <= 65535:  # getaddrinfo would use the number modulo 65536
        raise BadAddress(f"cannot listen on {where}: expected a port from 0 to 65535")
    bound = None
    try:
        places = socket.getaddrinfo(host or "0.0.0.0", port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)
        family, kind, protocol, _, address = min(places, key=lambda place: place[0] != socket.AF_INET)
        bound = socket.socket(family, kind, protocol)
        bound.setblocking(False)
        if hasattr(socket, "SO_EXCLUSIVEADDRUSE"):
            # On Windows, SO_REUSEADDR would allow another program to take the port while it is in use.
            bound.setsockopt(socket.SOL_SOCKET, socket.SO_EXCLUSIVEADDRUSE, 1)
        else:
            # On other systems, a port with connections could otherwise not be bound again for minutes (TIME_WAIT).
            bound.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        if family == socket.AF_INET6:
            # Otherwise a setting of the system decides whether "::" also accepts IPv4.
            bound.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, int(host != "::"))
        bound.bind(address)
    except (OSError, ValueError, OverflowError) as error:
        if bound is not None:
            bound.close()
        reason = getattr(error, "strerror", None) or error
        raise BadAddress(f"cannot listen on {where}: {reason}") from error
    return bound


def numeric_host(address: str) -> str:
    """Return the address of a peer in a form that can be compared and printed.

    An IPv4 address that a dual-stack socket reports as IPv6 becomes IPv4 again.

    >>> numeric_host("::ffff:192.168.1.2"), numeric_host("fe80::1%eth0")
    ('192.168.1.2', 'fe80::1%eth0')
    """
    return address.removeprefix("::ffff:") if "." in address else address


class TcpListener:
    """A port that accepts one connection at a time. It is a context manager that closes itself.

    Args:
        host: Address of this computer to listen on. See the module's description for `""` and `"::"`.
        port: TCP port; 0 for a free port.

    Attributes:
        address: Address (host, port) on which the listener listens.

    Raises:
        BadAddress: If the address is in use, is not an address of this computer, or has an invalid port.
    """

    def __init__(self, host: str, port: int = 0) -> None:
        listener = bound_socket(host, port)
        try:
            listener.listen(1)
        except OSError as error:  # another socket that was bound to the same port already listens
            listener.close()
            raise BadAddress(f"cannot listen on {host or '*'}:{port}: {error.strerror}") from error
        # One thread takes it to close it. Two threads that closed a descriptor at the same time could close the
        # descriptor of another connection.
        self._socket: MadeOnce[socket.socket] = MadeOnce()
        self._socket.keep(listener)
        bound = listener.getsockname()
        self.address: tuple[str, int] = (bound[0], bound[1])
        self._home = HomeProcess(f"{self.address[0]}:{self.address[1]}")
        _listeners.add(self)

    def accept(self, timeout: float) -> TcpTransport:
        """Wait up to `timeout` seconds for a connection, and return it; with 0, accept only a waiting connection.

        Raises:
            LinkTimeout: If no peer connects in time.
            ConnectFailed: If the listener was closed.
            ConnectionLost: If the peer has connected and already disconnected.
            LocalError: If this process was forked from the process that listens.
        """
        self._home.check()
        listener = self._socket.made
        where = f"{self.address[0]}:{self.address[1]}"
        if listener is None:
            raise ConnectFailed(f"the listener on {where} was closed")
        try:
            listener.settimeout(max(timeout, 0.0))
            connection, peer = listener.accept()
        except BlockingIOError:
            raise LinkTimeout(f"no connection to {where} yet") from None
        except TimeoutError:
            raise LinkTimeout(f"no connection to {where} within {timeout:g} s") from None
        except ConnectionError as error:
            raise mapped(error, f"a connection to {where}", timeout, ConnectionLost) from error
        except OSError as error:
            if error.errno == errno.ENOTCONN:  # the connection was reset before it was accepted (Wine)
                raise mapped(error, f"a connection to {where}", timeout, ConnectionLost) from error
            raise mapped(error, f"waiting on {where}", timeout, ConnectFailed) from error
        transport = TcpTransport(numeric_host(peer[0]), peer[1], silence=_SILENCE)
        transport.adopt(connection)
        return transport

    def close(self) -> None:
        """Stop listening, and wake a thread that waits in `accept`.

        Accepted connections stay open. Idempotent.
        """
        listener = self._socket.take()
        if listener is None:
            return
        # On systems that cannot shut down a listening socket, closing it wakes the thread.
        with contextlib.suppress(OSError):
            listener.shutdown(socket.SHUT_RDWR)
        listener.close()

    def __enter__(self) -> TcpListener:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()


#: All listeners of this process.
_listeners: weakref.WeakSet[TcpListener] = weakref.WeakSet()


def _leave_to_parent() -> None:
    """Close the copies of the sockets in a forked child, so that it cannot take the parent's connections."""
    for each in list(_listeners):
        listener = each._socket.take()
        if listener is not None:
            listener.close()


if hasattr(os, "register_at_fork"):  # not on Windows, which cannot fork
    os.register_at_fork(after_in_child=_leave_to_parent)


def addresses(host: str) -> frozenset[str]:
    """Return the numeric addresses of a host, in the same form as the addresses of accepted peers.

    Raises:
        ConnectFailed: If there is no such host.
    """
    try:
        places = socket.getaddrinfo(host, None, type=socket.SOCK_STREAM)
    except (OSError, ValueError) as error:
        raise mapped(error, f"cannot find {host}", 0.0, ConnectFailed) from error
    return frozenset(numeric_host(str(place[4][0])) for place in places)


def local_address(host: str) -> str:
    """Return the address of this computer on the route to `host`. Nothing is sent.

    Raises:
        ConnectFailed: If there is no such host, or no route to it.
    """
    # Connecting a datagram socket only selects the route, and the port does not matter.
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(host, 9, type=socket.SOCK_DGRAM)[0]
        with socket.socket(family, kind, protocol) as probe:
            probe.connect(address)
            here: str = probe.getsockname()[0]
    except (OSError, ValueError) as error:
        raise mapped(error, f"cannot find the route to {host}", 0.0, ConnectFailed) from error
    return here

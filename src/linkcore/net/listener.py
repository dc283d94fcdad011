"""Listening sockets, the one place where they are made, and `TcpListener`, which waits for a single peer.

A server of many clients takes its listening sockets from `linkcore.net.loop`, which makes them here too.

Host names are decided once, for every port that this project opens:

- `""` is every IPv4 address of this computer. The peers are robots and their tools, whose programs open sockets to
  IPv4 addresses only.
- `"::"` is every address of either family (dual stack), where the system has IPv6.
- A name or an address is that one; a name with addresses of both families is its IPv4 address.
"""

from __future__ import annotations

import contextlib
import os
import socket
import weakref

from ..errors import BadAddress, ConnectFailed, ConnectionLost, LinkTimeout
from ..process import HomeProcess
from .transport import TcpTransport, mapped

#: Seconds without a byte after which a connection that was accepted counts as silent.
_SILENCE = 2.0


def bound_socket(host: str, port: int, *, purpose: str = "") -> socket.socket:
    """A non-blocking TCP socket that is bound and does not listen yet, so that connections are refused.

    Args:
        host: address of this computer; see the module's description for `""` and `"::"`.
        port: 0 for one that is free.
        purpose: what the port is for; stands in the error's text.

    Raises:
        BadAddress: taken, not an address of this computer, or no such port.
    """
    where = f"{host or '*'}:{port}" + (f" for {purpose}" if purpose else "")
    if not 0 <= port <= 65535:  # getaddrinfo takes a number modulo 65536
        raise BadAddress(f"cannot listen on {where}: expected a port from 0 to 65535")
    bound = None
    try:
        places = socket.getaddrinfo(host or "0.0.0.0", port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)
        family, kind, protocol, _, address = min(places, key=lambda place: place[0] != socket.AF_INET)
        bound = socket.socket(family, kind, protocol)
        bound.setblocking(False)
        if hasattr(socket, "SO_EXCLUSIVEADDRUSE"):
            # Windows, where SO_REUSEADDR would let another program take the port while it is in use.
            bound.setsockopt(socket.SOL_SOCKET, socket.SO_EXCLUSIVEADDRUSE, 1)
        else:
            # Elsewhere without it a port cannot be bound again for minutes after it had connections (TIME_WAIT).
            bound.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        if family == socket.AF_INET6:
            # Whether "::" takes IPv4 as well is a setting of the system otherwise.
            bound.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, int(host != "::"))
        bound.bind(address)
    except (OSError, ValueError, OverflowError) as error:
        if bound is not None:
            bound.close()
        reason = getattr(error, "strerror", None) or error
        raise BadAddress(f"cannot listen on {where}: {reason}") from error
    return bound


def numeric_host(address: str) -> str:
    """The address of a peer as it is compared and printed: IPv4 seen through a dual-stack socket is IPv4 again.

    >>> numeric_host("::ffff:192.168.1.2"), numeric_host("fe80::1%eth0")
    ('192.168.1.2', 'fe80::1%eth0')
    """
    return address.removeprefix("::ffff:") if "." in address else address


class TcpListener:
    """A port that takes connections one at a time. A context manager that closes itself.

    Args:
        host: address of this computer to listen on; see the module's description for `""` and `"::"`.
        port: 0 for one that is free.

    Attributes:
        address: (host, port) that it listens on.

    Raises:
        BadAddress: it cannot be listened on: taken, not an address of this computer, no such port.
    """

    def __init__(self, host: str, port: int = 0) -> None:
        listener = bound_socket(host, port)
        try:
            listener.listen(1)
        except OSError as error:  # another socket that was bound to this port as well listens already
            listener.close()
            raise BadAddress(f"cannot listen on {host or '*'}:{port}: {error.strerror}") from error
        self._socket: socket.socket | None = listener
        bound = listener.getsockname()
        self.address: tuple[str, int] = (bound[0], bound[1])
        self._home = HomeProcess(f"{self.address[0]}:{self.address[1]}")
        _listeners.add(self)

    def accept(self, timeout: float) -> TcpTransport:
        """The next connection, made within `timeout` seconds; 0 takes one that is there already.

        Raises:
            LinkTimeout: no connection came.
            ConnectFailed: the listener was closed.
            ConnectionLost: the peer that connected has disconnected again.
            LocalError: in a process that was forked from the one which listens.
        """
        self._home.check()
        listener = self._socket
        where = f"{self.address[0]}:{self.address[1]}"
        if listener is None:
            raise ConnectFailed(f"{where} is not listened on any more")
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
            raise mapped(error, f"waiting on {where}", timeout, ConnectFailed) from error
        transport = TcpTransport(numeric_host(peer[0]), peer[1], silence=_SILENCE)
        transport.adopt(connection)
        return transport

    def close(self) -> None:
        """Listen no longer, and wake a thread that waits in `accept`. Idempotent; what was accepted stays."""
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


#: The listeners of this process.
_listeners: weakref.WeakSet[TcpListener] = weakref.WeakSet()


def _leave_to_parent() -> None:
    """Run in a forked child: close its copies, so that nothing it calls takes or refuses the parent's connections."""
    for each in list(_listeners):
        listener, each._socket = each._socket, None
        if listener is not None:
            listener.close()


if hasattr(os, "register_at_fork"):  # not on Windows, which cannot fork
    os.register_at_fork(after_in_child=_leave_to_parent)


def addresses(host: str) -> frozenset[str]:
    """The numeric addresses of a host, as `TcpListener.accept` names a peer that connects from there.

    Raises:
        ConnectFailed: no such host.
    """
    try:
        places = socket.getaddrinfo(host, None, type=socket.SOCK_STREAM)
    except (OSError, ValueError) as error:
        raise mapped(error, f"cannot find {host}", 0.0, ConnectFailed) from error
    return frozenset(numeric_host(str(place[4][0])) for place in places)


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

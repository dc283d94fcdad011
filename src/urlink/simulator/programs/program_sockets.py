"""The sockets that programs open: from the controller to the host that they name.

Programs reach this computer and the computers that are connected to the controller; others only if the controller
allows them. For a program, 127.0.0.1 is the controller, with the port numbers of a real one, whichever numbers they are
served at. Names are not looked up, since that could take seconds. Nothing here waits, see
`linkcore.net.polled`.
"""

from __future__ import annotations

import ipaddress
from collections.abc import Callable

from linkcore.net.polled import PolledConnection, State

__all__ = ["ProgramSockets", "Route"]

#: Where a connection to a numeric address and a port goes; None if a program may not connect to it.
Route = Callable[[str, int], tuple[str, int] | None]

#: Sockets that a program may have at once; those count that only their peer has closed.
MOST = 16
#: Bytes that wait for a program; beyond them the peer has to wait.
MOST_WAITING = 1 << 16


class ProgramSockets:
    """The named sockets of one program.

    Args:
        route: where connections go.
    """

    def __init__(self, route: Route) -> None:
        self._route = route
        self._connections: dict[str, PolledConnection] = {}

    def open(self, name: str, host: str, port: int) -> None:
        """Begin to connect; a socket with the same name is closed."""
        self.close(name)
        try:
            address = str(ipaddress.ip_address("127.0.0.1" if host == "localhost" else host))
        except ValueError:
            return
        target = self._route(address, port)
        if target is not None and 0 < target[1] < 65536 and len(self._connections) < MOST:
            self._connections[name] = PolledConnection(*target, most_waiting=MOST_WAITING)

    def state(self, name: str) -> State:
        """The state of a socket; "closed" also if it was refused, or if the program has too many."""
        connection = self._connections.get(name)
        return "closed" if connection is None else connection.state

    def send(self, name: str, data: bytes) -> bool:
        """Send all of it at once. False if it is not open, or if the peer does not take all; then it is closed."""
        connection = self._connections.get(name)
        return connection is not None and connection.send(data)

    def received(self, name: str) -> bytearray:
        """Bytes that were received and not yet removed; the caller deletes those that it uses."""
        connection = self._connections.get(name)
        return bytearray() if connection is None else connection.receive()

    def close(self, name: str) -> None:
        """Close a socket, if it exists, and discard its bytes."""
        connection = self._connections.pop(name, None)
        if connection is not None:
            connection.close()

    def close_all(self) -> None:
        """Close every one."""
        for name in list(self._connections):
            self.close(name)

"""The connection that a program on the robot makes back to this computer."""

from __future__ import annotations

import logging
import threading

from linkcore.errors import ConnectFailed, ConnectionLost, LinkTimeout
from linkcore.net.listener import TcpListener, addresses, local_address
from linkcore.net.transport import TcpTransport

__all__ = ["ReverseLink"]

_log = logging.getLogger(__name__)

#: Seconds that the robot may take to accept what is sent; the gate is held meanwhile, so a stop waits for it.
_SEND_TIMEOUT = 0.05


class ReverseLink:
    """A port that waits for one program on the robot, and then its connection.

    Whoever connects from an address that is not the robot's is refused, and the port goes on listening.

    Args:
        robot: where the controller is.
        host: address at which the robot finds this computer; None for the one on the route to it.
        port: 0 for one that is free.

    Attributes:
        address: (host, port) that the program is told.

    Raises:
        BadAddress: the port cannot be listened on.
        ConnectFailed: there is no route to the robot.
    """

    def __init__(self, robot: str, host: str | None = None, port: int = 0) -> None:
        here = local_address(robot) if host is None else host
        # An address that was given may be one that something in between translates, so it is not one to listen on.
        self._peers = addresses(robot)
        self._listener = TcpListener(here if host is None else "", port)
        self.address = (here, self._listener.address[1])
        self._connection: TcpTransport | None = None
        self._closing = threading.Lock()
        self._is_closed = False

    @property
    def is_up(self) -> bool:
        """The program has connected."""
        return self._connection is not None

    def poll(self) -> bool:
        """Take the connection, if it has been made; True once it has. Never waits."""
        if self._connection is None:
            try:
                connection = self._listener.accept(0)
            except (LinkTimeout, ConnectionLost):
                return False
            if connection.host not in self._peers:
                _log.warning(
                    "%s connected to the port for a program on the robot and was refused; the robot is at %s",
                    connection.name,
                    ", ".join(sorted(self._peers)),
                )
                connection.close()
                return False
            with self._closing:
                if self._is_closed:  # by another thread, in the meantime
                    connection.close()
                    return False
                self._connection = connection
            self._listener.close()
        return True

    def send(self, data: bytes) -> None:
        """Send to the program.

        Raises:
            ConnectionLost: it is gone, or does not read.
        """
        if self._connection is None:
            raise ConnectionLost("the program on the robot is not connected")
        try:
            self._connection.send(data, _SEND_TIMEOUT)
        except LinkTimeout as error:
            raise ConnectionLost(f"{error}; it does not read") from error

    def received(self) -> bytes:
        """What the program has sent since; never waits.

        Raises:
            ConnectionLost: it is gone.
        """
        data = b""
        try:
            while self._connection is not None and (more := self._connection.receive_waiting()) is not None:
                data += more[0]
        except ConnectionLost:
            if not data:  # its last words come first
                raise
        return data

    def absence(self, why: str) -> ConnectFailed:
        """What to raise when the program does not connect."""
        host, port = self.address
        return ConnectFailed(
            f"the program on the robot could not connect to this computer at {host}:{port}: {why}. Is that an address "
            "by which the robot reaches it (set another with reverse_host), and does the firewall let it in (a fixed "
            "port is set with reverse_port)?"
        )

    def close(self) -> None:
        """Close the port and the connection; never waits. Idempotent.

        Set-points that the robot has not acknowledged are discarded. The program sees that its connection ended, and
        brakes by itself.
        """
        with self._closing:
            self._is_closed = True
        self._listener.close()
        if self._connection is not None:
            self._connection.close(0)

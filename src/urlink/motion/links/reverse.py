"""Connection from a program on the robot to this computer."""

from __future__ import annotations

import contextlib
import logging
import random

from linkcore.errors import ConnectFailed, ConnectionLost, LinkTimeout
from linkcore.net.listener import TcpListener, addresses, local_address
from linkcore.net.transport import TcpTransport

from ...script.links import TOKENS, ReverseSocket

_log = logging.getLogger(__name__)

#: Maximum number of connections that have not yet sent their token. It is bounded, because other peers can reach the
#: port.
_MOST_CANDIDATES = 8
#: Number of bytes of a token.
_TOKEN_SIZE = 4

#: A connection, and the bytes that it has sent so far.
_Candidate = tuple[TcpTransport, bytearray]


class ReversePort:
    """Address and port that programs on the robot connect to.

    Args:
        robot: Address of the controller.
        host: Address of this computer as seen by the robot. If None, use the address on the route to the robot.
        port: TCP port to listen on; 0 for a free one.
        peer: Source address of the connections of programs. If None, it is the robot's own address.
    """

    def __init__(self, robot: str, host: str | None = None, port: int = 0, peer: str | None = None) -> None:
        self.robot = robot
        self.host = host
        self.port = port
        self.peer = peer
        self._link: ReverseLink | None = None

    def open(self) -> ReverseLink:
        """Listen for the next program.

        With a fixed port, the previous link stops listening first, because its program will be replaced.

        Raises:
            BadAddress: If the port cannot be opened.
            ConnectFailed: If there is no route to the robot.
        """
        if self.port and self._link is not None:
            self._link.stop_listening()
        link = self._link = ReverseLink(self)
        return link  # rather than self._link, which another thread may have set meanwhile


class ReverseLink:
    """A port that waits for the connection of one program on the robot, and then this connection.

    A program identifies itself by the token in its text. A peer is refused if its address is not the robot's, or if it
    sends other bytes, and the port continues to listen. The port is closed when the program has connected, and at the
    latest when the link is closed. A program that the controller starts later cannot connect.

    Args:
        where: Addresses of the robot and of this computer.

    Attributes:
        endpoint: Address and token, for the program's text.

    Raises:
        BadAddress: If the port cannot be opened.
        ConnectFailed: If there is no route to the robot.
    """

    def __init__(self, where: ReversePort) -> None:
        here = local_address(where.robot) if where.host is None else where.host
        self._peers = addresses(where.robot if where.peer is None else where.peer)
        # A given address may be translated by NAT, so this computer may not be able to listen on it.
        self._listener = TcpListener(here if where.host is None else "", where.port)
        self.endpoint = ReverseSocket(here, self._listener.address[1], random.SystemRandom().randrange(TOKENS))
        self._candidates: list[_Candidate] = []
        self._connection: TcpTransport | None = None
        self._waiting = b""  # bytes that arrived directly after the token
        self._is_closed = False

    @property
    def is_up(self) -> bool:
        """Whether the program has connected."""
        return self._connection is not None

    def poll(self, has_begun: bool) -> bool:
        """Accept the connection if it has been made; return True when it was accepted. Never waits."""
        while self._connection is None and (connection := self._accepted()) is not None:
            candidate = (connection, bytearray())
            if connection.host not in self._peers:
                self._refuse(candidate, f"the robot is at {', '.join(sorted(self._peers))}")
            else:
                self._candidates.append(candidate)
                if len(self._candidates) > _MOST_CANDIDATES:
                    self._refuse(self._candidates[0], "it sent no token")
        for candidate in tuple(self._candidates):
            if self._connection is None:
                self._look(candidate)
        if self._is_closed:  # closed by another thread, which did not yet see a connection that was accepted here
            self.stop_listening()
        return self._connection is not None

    def _accepted(self) -> TcpTransport | None:
        while True:
            try:
                return self._listener.accept(0)
            except ConnectionLost:
                pass  # closed again by the peer; there may be another connection
            except (LinkTimeout, ConnectFailed):
                return None

    def _look(self, candidate: _Candidate) -> None:
        """Read the token of a candidate."""
        connection, said = candidate
        try:
            received = connection.receive_waiting()
        except ConnectionLost:
            self._drop(candidate)
            return
        if received is not None:
            said += received[0]
        token = self.endpoint.token.to_bytes(_TOKEN_SIZE, "big")
        if said[:_TOKEN_SIZE] == token:
            self._waiting = bytes(said[_TOKEN_SIZE:])
            self._connection = connection
            self._forget(candidate)
            self.stop_listening()
            if self._is_closed:  # closed by another thread in the meantime
                connection.abort()
        elif not token.startswith(said[:_TOKEN_SIZE]):
            self._refuse(candidate, "it did not send the token of the expected program")

    def _refuse(self, candidate: _Candidate, why: str) -> None:
        name = candidate[0].name
        _log.warning("%s: connection to the port for a program on the robot was refused: %s", name, why)
        self._drop(candidate)

    def _drop(self, candidate: _Candidate) -> None:
        candidate[0].abort()
        self._forget(candidate)

    def _forget(self, candidate: _Candidate) -> None:
        with contextlib.suppress(ValueError):  # it is not in the list yet, or another thread is closing
            self._candidates.remove(candidate)

    def stop_listening(self) -> None:
        """Stop accepting connections."""
        self._listener.close()
        while self._candidates:
            try:
                connection, _ = self._candidates.pop()
            except IndexError:  # another thread has taken the last one
                break
            connection.abort()

    def send(self, data: bytes) -> None:
        """Send to the program, at once and completely.

        Raises:
            ConnectionLost: If the connection is closed, or if the program does not read.
        """
        connection = self._connection
        if connection is None:
            raise ConnectionLost("the program on the robot is not connected")
        if connection.send_some(data) < len(data):
            # The kernel has buffered some hundred set-points by now. A partly sent one would shift all that follow.
            connection.abort()
            raise ConnectionLost(f"{connection.name}: the program on the robot does not read its messages")

    def received(self) -> bytes:
        """Return the bytes that the program has sent since the last call; never waits.

        Raises:
            ConnectionLost: If the connection is closed.
        """
        data, self._waiting = self._waiting, b""
        try:
            while self._connection is not None and (more := self._connection.receive_waiting()) is not None:
                data += more[0]
        except ConnectionLost:
            if not data:  # the last bytes are returned first
                raise
        return data

    def absence(self, why: str) -> ConnectFailed:
        """Return the error for a program that does not connect."""
        host, port, _ = self.endpoint
        return ConnectFailed(
            f"the program on the robot could not connect to this computer at {host}:{port}: {why}. Check that the "
            "robot can reach this address (otherwise set reverse_host), that the firewall accepts the connection "
            "(reverse_port sets a fixed port), and that the robot connects from the address that urlink connects to "
            "(otherwise set reverse_peer)"
        )

    def close(self, *, farewell: bool = False) -> None:
        """Close the port and the connection, and discard data that has not arrived. Idempotent.

        Args:
            farewell: Whether the bytes that were sent last must arrive. If so, wait for them up to a fraction of a
                second.
        """
        self._is_closed = True
        self.stop_listening()
        connection = self._connection
        if connection is not None:
            if farewell:
                connection.close()
            else:
                connection.abort()

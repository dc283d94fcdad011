"""Reverse link: connection that a program on the robot makes to this computer."""

from __future__ import annotations

import contextlib
import logging
import random
from collections.abc import Callable

from linkcore.errors import ConnectFailed, ConnectionLost, LinkTimeout
from linkcore.net.listener import TcpListener, addresses, local_address
from linkcore.net.transport import TcpTransport

from ...script.links import TOKENS, ReverseSocket

_log = logging.getLogger(__name__)

#: Maximum number of connections that have not yet sent their token. The number is limited, because any computer in the
#: network can connect to the port.
_MOST_CANDIDATES = 8
#: Number of bytes of a token.
_TOKEN_SIZE = 4

#: A connection, and the bytes that have been received from it so far.
_Candidate = tuple[TcpTransport, bytearray]


class ReversePort:
    """Address and port on this computer to which programs on the robot connect.

    Args:
        robot: Address of the controller.
        host: Address of this computer that programs on the robot use. If None, the address from which this computer
            reaches the robot.
        port: TCP port to listen on; 0 for a free one.
        peer: Source address of connections from programs on the robot. If None, the address of the robot.
        sent: Function that is called with the bytes that were sent to a program; None for none.
    """

    def __init__(
        self,
        robot: str,
        host: str | None = None,
        port: int = 0,
        peer: str | None = None,
        sent: Callable[[bytes | memoryview], object] | None = None,
    ) -> None:
        self.sent = sent
        self.robot = robot
        self.host = host
        self.port = port
        self.peer = peer
        self._link: ReverseLink | None = None

    def open(self) -> ReverseLink:
        """Listen for the next program.

        If the port is fixed, the previous link stops listening first, because the next program replaces its program.

        Raises:
            BadAddress: If the port cannot be opened.
            ConnectFailed: If there is no route to the robot.
        """
        if self.port and self._link is not None:
            self._link.stop_listening()
        link = self._link = ReverseLink(self)
        return link  # rather than self._link, which another thread may have set meanwhile


class ReverseLink:
    """Reverse link of one program: a port that waits for the program, and later the connection of the program.

    A program identifies itself with the token in its text. A connection is refused if it comes from another address
    than the robot's, or if it does not send this token. The port then continues to listen. The port is closed when the
    program has connected, and at the latest when the link is closed. If the controller starts the program later, it
    cannot connect.

    Args:
        where: Addresses of the robot and of this computer, and the port.

    Attributes:
        endpoint: Address and token, for the program's text.

    Raises:
        BadAddress: If the port cannot be opened.
        ConnectFailed: If there is no route to the robot.
    """

    def __init__(self, where: ReversePort) -> None:
        here = local_address(where.robot) if where.host is None else where.host
        self._sent = where.sent
        self._peers = addresses(where.robot if where.peer is None else where.peer)
        # Listen on all addresses if `host` was given: this address may be translated by NAT, and may not exist on this
        # computer.
        self._listener = TcpListener(here if where.host is None else "", where.port)
        self.endpoint = ReverseSocket(here, self._listener.address[1], random.SystemRandom().randrange(TOKENS))
        self._candidates: list[_Candidate] = []
        self._connection: TcpTransport | None = None
        self._waiting = b""  # bytes that arrived together with the token
        self._is_closed = False

    @property
    def is_up(self) -> bool:
        """Whether the program has connected."""
        return self._connection is not None

    def poll(self, has_begun: bool) -> bool:
        """Accept the connection of the program if it has arrived; return whether the link is up. Never waits."""
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
        if self._is_closed:  # another thread has closed the link, and may have missed this new connection
            self.stop_listening()
        return self._connection is not None

    def _accepted(self) -> TcpTransport | None:
        while True:
            try:
                return self._listener.accept(0)
            except ConnectionLost:
                pass  # the peer has closed this connection again; there may be another one
            except (LinkTimeout, ConnectFailed):
                return None

    def _look(self, candidate: _Candidate) -> None:
        """Read the token from a candidate, and accept or refuse this connection."""
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
            connection.sent = self._sent
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
        with contextlib.suppress(ValueError):  # not in the list yet, or removed by a thread that closes the link
            self._candidates.remove(candidate)

    def stop_listening(self) -> None:
        """Close the port, and the connections that have not sent their token."""
        self._listener.close()
        while self._candidates:
            try:
                connection, _ = self._candidates.pop()
            except IndexError:  # another thread has taken the last one
                break
            connection.abort()

    def send(self, data: bytes) -> None:
        """Send data to the program without waiting; either all bytes are sent, or the connection is aborted.

        Raises:
            ConnectionLost: If the connection is closed, or if the program does not read its messages.
        """
        connection = self._connection
        if connection is None:
            raise ConnectionLost("the program on the robot is not connected")
        if connection.send_some(data) < len(data):
            # The kernel has buffered several hundred set-points by now. After a partly sent set-point, the program
            # would misread all later ones.
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
        """Close the port and the connection. Idempotent.

        Data that has not yet been delivered is discarded, except with `farewell`.

        Args:
            farewell: Whether the last bytes must be delivered. If True, wait for this up to a fraction of a second.
        """
        self._is_closed = True
        self.stop_listening()
        connection = self._connection
        if connection is not None:
            if farewell:
                connection.close()
            else:
                connection.abort()

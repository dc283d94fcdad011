"""TCP server for tests that serves one connection after another, in a thread."""

from __future__ import annotations

import contextlib
import socket
import threading

__all__ = ["OneAfterAnother"]


class OneAfterAnother:
    """Server that listens on a free port of this computer, and serves one client after another.

    Args:
        timeout: Time limit for a client to send, and for the thread to end, in seconds.

    Attributes:
        port: Number of the port.
        connections: Number of connections accepted so far.
    """

    def __init__(self, timeout: float = 10.0) -> None:
        self._timeout = timeout
        self.connections = 0
        self._connection: socket.socket | None = None
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port: int = self._listener.getsockname()[1]
        self._thread = threading.Thread(target=self._serve)
        self._thread.start()

    def _serve(self) -> None:
        while True:
            try:
                connection, _ = self._listener.accept()
            except OSError:
                return
            self.connections += 1
            self._connection = connection
            with connection, contextlib.suppress(OSError):
                connection.settimeout(self._timeout)
                self._talk(connection)

    def _talk(self, connection: socket.socket) -> None:
        """Exchange all data with a client. The connection is closed on return."""
        raise NotImplementedError

    def close(self) -> None:
        """End the connection and the thread."""
        for each in (self._connection, self._listener):
            if each is not None:
                with contextlib.suppress(OSError):
                    each.shutdown(socket.SHUT_RDWR)
        self._listener.close()
        self._thread.join(self._timeout)
        assert not self._thread.is_alive()

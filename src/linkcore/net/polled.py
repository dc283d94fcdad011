"""Outgoing TCP connection that never blocks. The owner polls the connection, for example once per cycle.

Use it for programs whose time is counted in cycles. With a thread or a wait, the result of such a program would depend
on the speed of the computer.
"""

from __future__ import annotations

import contextlib
import errno
import ipaddress
import socket
from typing import Literal

#: "closed" by either side after it was open; "failed" if it was never open.
State = Literal["connecting", "open", "failed", "closed"]

_IN_PROGRESS = {0, errno.EINPROGRESS, errno.EWOULDBLOCK, errno.EALREADY}


class PolledConnection:
    """Outgoing connection. The connection attempt starts when the object is made.

    The methods never wait, and never raise `OSError`. The object uses a descriptor while it connects and while it is
    open.

    Args:
        host: Numeric address. Names are not resolved, because this can take seconds.
        port: TCP port, 1 to 65535.
        most_waiting: Maximum number of bytes in `received`. If there are more, the peer has to wait.
        source: Numeric address of this computer from which to connect; None if the system should choose it.

    Attributes:
        received: Received bytes. The owner deletes the bytes that it has used.
    """

    def __init__(self, host: str, port: int, *, most_waiting: int = 1 << 16, source: str | None = None) -> None:
        self.received = bytearray()
        self._most_waiting = most_waiting
        self._state: State = "failed"
        self._socket: socket.socket | None = None
        try:
            version = ipaddress.ip_address(host).version
            link = socket.socket(socket.AF_INET6 if version == 6 else socket.AF_INET, socket.SOCK_STREAM)
        except (OSError, ValueError):
            return  # no descriptor is left, or the address is invalid
        self._socket = link
        try:
            link.setblocking(False)
            link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            if source is not None:
                link.bind((source, 0))
            has_begun = link.connect_ex((host, port)) in _IN_PROGRESS
        except (OSError, OverflowError):
            has_begun = False  # this computer has no such kind or zone of addresses, or the port is invalid
        if has_begun:
            self._state = "connecting"
        else:
            self._end("failed")

    @property
    def state(self) -> State:
        """Current state."""
        link = self._socket
        if link is not None and self._state == "connecting":
            if link.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR):
                self._end("failed")
            else:
                # `select` could detect this too, but it accepts only descriptors below 1024.
                with contextlib.suppress(OSError):
                    link.getpeername()
                    self._state = "open"
        return self._state

    def send(self, data: bytes) -> bool:
        """Send all of `data` at once.

        Return False if the connection is not open, or if the peer does not accept all of the data. In the second case,
        the connection is closed.
        """
        if self.state != "open" or self._socket is None:
            return False
        with contextlib.suppress(OSError):
            if self._socket.send(data) == len(data):
                return True
        # The peer would read the next message as the rest of this one.
        self._end("closed")
        return False

    def receive(self) -> bytearray:
        """Read the available bytes from the kernel; return `received`.

        Earlier bytes stay readable after the end.
        """
        room = self._most_waiting - len(self.received)
        if room > 0 and self.state == "open" and self._socket is not None:
            try:
                data = self._socket.recv(room)
            except BlockingIOError:
                return self.received
            except OSError:
                data = b""
            if data:
                self.received += data
            else:
                self._end("closed")
        return self.received

    def close(self) -> None:
        """Close the connection, and discard the received bytes. Idempotent."""
        if self._socket is not None:
            self._end("closed")
        self.received.clear()

    def _end(self, state: State) -> None:
        self._state = state
        link, self._socket = self._socket, None
        if link is not None:
            with contextlib.suppress(OSError):
                link.close()

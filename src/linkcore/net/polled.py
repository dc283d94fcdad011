"""An outgoing TCP connection that never blocks: its owner polls it, such as once in every cycle.

For programs whose time is counted in cycles, where a thread or a wait would make the outcome depend on the machine.
"""

from __future__ import annotations

import contextlib
import errno
import ipaddress
import socket
from typing import Literal

#: "closed" by either side, after it was open; "failed" before it was.
State = Literal["connecting", "open", "failed", "closed"]

_IN_PROGRESS = {0, errno.EINPROGRESS, errno.EWOULDBLOCK, errno.EALREADY}


class PolledConnection:
    """One connection, begun when it is made. None of its methods waits, and none raises an `OSError`.

    It holds a descriptor while it connects and while it is open.

    Args:
        host: numeric address; names are not looked up, since that can take seconds.
        port: TCP port, 1 to 65535.
        most_waiting: bytes that wait to be taken from `received`; beyond them the peer has to wait.
        source: numeric address of this computer to connect from; None for the one that the system chooses.

    Attributes:
        received: bytes that have come. Who takes some deletes them here.
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
            return  # no descriptor is left, or no such address
        self._socket = link
        try:
            link.setblocking(False)
            link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            if source is not None:
                link.bind((source, 0))
            has_begun = link.connect_ex((host, port)) in _IN_PROGRESS
        except (OSError, OverflowError):
            has_begun = False  # an address of a kind or zone that this computer does not have; no such port
        if has_begun:
            self._state = "connecting"
        else:
            self._end("failed")

    @property
    def state(self) -> State:
        """How far it is now."""
        link = self._socket
        if link is not None and self._state == "connecting":
            if link.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR):
                self._end("failed")
            else:
                # `select` would tell too, but takes no descriptor from 1024 on.
                with contextlib.suppress(OSError):
                    link.getpeername()
                    self._state = "open"
        return self._state

    def send(self, data: bytes) -> bool:
        """Send all of it at once. False: it is not open, or the peer does not take all of it, and it is closed now."""
        if self.state != "open" or self._socket is None:
            return False
        with contextlib.suppress(OSError):
            if self._socket.send(data) == len(data):
                return True
        # Half of a message would be taken for the beginning of the next.
        self._end("closed")
        return False

    def receive(self) -> bytearray:
        """Take what has come from the kernel; returns `received`. What came before the end can be read after it."""
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
        """End it, and forget what has come. Idempotent."""
        if self._socket is not None:
            self._end("closed")
        self.received.clear()

    def _end(self, state: State) -> None:
        self._state = state
        link, self._socket = self._socket, None
        if link is not None:
            with contextlib.suppress(OSError):
                link.close()

"""The sockets that programs open: from the controller to whoever they name.

Nothing here waits: a connection is begun, and looked at again in every cycle in which a program asks for it. Programs
reach this computer and those that are connected to the controller; others only where the controller allows them, and
names are not looked up, since that could take seconds.
"""

from __future__ import annotations

import contextlib
import errno
import ipaddress
import socket
from collections.abc import Callable
from typing import Literal

__all__ = ["ProgramSockets"]

State = Literal["connecting", "open", "failed", "closed"]

#: Sockets that a program may have at once, those included that it has not closed after their peer did.
MOST = 16
#: Bytes that wait for a program; beyond them the peer has to wait.
MOST_WAITING = 1 << 16

_IN_PROGRESS = {0, errno.EINPROGRESS, errno.EWOULDBLOCK, errno.EALREADY}


class _Socket:
    """One named socket; it holds a descriptor while it connects and while it is open."""

    def __init__(self, link: socket.socket) -> None:
        self.link = link
        self.state: State = "connecting"
        self.received = bytearray()

    def end(self, state: State) -> None:
        self.state = state
        with contextlib.suppress(OSError):
            self.link.close()


class ProgramSockets:
    """The named sockets of one program.

    Args:
        allows: whether a numeric address beyond this computer may be connected to.
    """

    def __init__(self, allows: Callable[[str], bool]) -> None:
        self._allows = allows
        self._sockets: dict[str, _Socket] = {}

    def open(self, name: str, host: str, port: int) -> None:
        """Begin to connect; the socket that had the name is closed."""
        self.close(name)
        address = self._numeric(host)
        if address is None or not 0 < port < 65536 or len(self._sockets) >= MOST:
            return
        try:
            link = socket.socket(socket.AF_INET6 if ":" in address else socket.AF_INET, socket.SOCK_STREAM)
        except OSError:
            return  # No descriptor is left.
        held = self._sockets[name] = _Socket(link)
        try:
            link.setblocking(False)
            link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            begun = link.connect_ex((address, port)) in _IN_PROGRESS
        except OSError:
            begun = False  # An address of a kind or zone that this computer does not have.
        if not begun:
            held.end("failed")

    def _numeric(self, host: str) -> str | None:
        try:
            address = ipaddress.ip_address("127.0.0.1" if host == "localhost" else host)
        except ValueError:
            return None
        return str(address) if address.is_loopback or self._allows(str(address)) else None

    def state(self, name: str) -> State:
        """How far it is; "closed" too where it was refused, or the program has too many."""
        held = self._sockets.get(name)
        if held is None:
            return "closed"
        if held.state == "connecting":
            if held.link.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR):
                held.end("failed")
            else:
                # Select would know too, but not of a descriptor with a high number.
                with contextlib.suppress(OSError):
                    held.link.getpeername()
                    held.state = "open"
        return held.state

    def send(self, name: str, data: bytes) -> bool:
        """Send all of it at once. False: it is not open, or the peer does not take it, and it is closed."""
        if self.state(name) != "open":
            return False
        held = self._sockets[name]
        with contextlib.suppress(OSError):
            if held.link.send(data) == len(data):
                return True
        # Half of a message is worse than none.
        held.end("closed")
        return False

    def received(self, name: str) -> bytearray:
        """What has come and was not taken; who takes some deletes it here."""
        is_open = self.state(name) == "open"
        held = self._sockets.get(name)
        if held is None:
            return bytearray()
        room = MOST_WAITING - len(held.received)
        if is_open and room > 0:
            try:
                data = held.link.recv(room)
            except BlockingIOError:
                return held.received
            except OSError:
                data = b""
            if data:
                held.received += data
            else:
                # What came before the end can still be read.
                held.end("closed")
        return held.received

    def close(self, name: str) -> None:
        """Close it, if it is there, and forget what has come."""
        held = self._sockets.pop(name, None)
        if held is not None:
            held.end("closed")

    def close_all(self) -> None:
        """Close every one."""
        for name in list(self._sockets):
            self.close(name)

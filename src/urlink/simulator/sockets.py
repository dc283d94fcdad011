"""The sockets that programs open: from the controller to whoever they name.

Nothing here waits: a connection is begun, and looked at again in every cycle in which a program asks for it. Programs
reach this computer and those that are connected to the controller; others only where the controller allows them, and
names are not looked up, since that could take seconds.
"""

from __future__ import annotations

import contextlib
import errno
import ipaddress
import select
import socket
from collections.abc import Callable
from typing import Literal

__all__ = ["ProgramSockets"]

State = Literal["connecting", "open", "failed", "closed"]

#: Sockets that a program may have open at once.
MOST = 16
#: Bytes that wait for a program; beyond them the peer has to wait.
MOST_WAITING = 1 << 16

_IN_PROGRESS = {errno.EINPROGRESS, errno.EWOULDBLOCK, errno.EALREADY}


class _Socket:
    def __init__(self, link: socket.socket) -> None:
        self.link = link
        self.state: State = "connecting"
        self.received = bytearray()


class ProgramSockets:
    """The named sockets of one program.

    Args:
        allows: whether a numeric address beyond this computer may be connected to.
    """

    def __init__(self, allows: Callable[[str], bool]) -> None:
        self._allows = allows
        self._sockets: dict[str, _Socket] = {}
        self._failed: set[str] = set()

    def open(self, name: str, host: str, port: int) -> None:
        """Begin to connect; the socket that had the name is closed."""
        self.close(name)
        address = self._numeric(host)
        if address is None or not 0 < port < 65536 or len(self._sockets) >= MOST:
            self._failed.add(name)
            return
        family = socket.AF_INET6 if ":" in address else socket.AF_INET
        link = socket.socket(family, socket.SOCK_STREAM)
        link.setblocking(False)
        link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        if link.connect_ex((address, port)) not in {0, *_IN_PROGRESS}:
            link.close()
            self._failed.add(name)
            return
        self._sockets[name] = _Socket(link)

    def _numeric(self, host: str) -> str | None:
        try:
            address = ipaddress.ip_address("127.0.0.1" if host == "localhost" else host)
        except ValueError:
            return None
        return str(address) if address.is_loopback or self._allows(str(address)) else None

    def state(self, name: str) -> State:
        """How far it is."""
        held = self._sockets.get(name)
        if held is None:
            return "failed" if name in self._failed else "closed"
        if held.state == "connecting" and select.select((), (held.link,), (), 0)[1]:
            if held.link.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR):
                self._fail(name)
                return "failed"
            held.state = "open"
        return held.state

    def send(self, name: str, data: bytes) -> bool:
        """Send all of it at once. False: it is not open, or the peer does not take it."""
        if self.state(name) != "open":
            return False
        try:
            if self._sockets[name].link.send(data) == len(data):
                return True
        except OSError:
            pass
        # Half of a message is worse than none.
        self._fail(name)
        return False

    def received(self, name: str) -> bytearray:
        """What has come and was not taken; who takes some deletes it here."""
        if self.state(name) != "open":
            held = self._sockets.get(name)
            return bytearray() if held is None else held.received
        held = self._sockets[name]
        room = MOST_WAITING - len(held.received)
        if room > 0:
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
                held.state = "closed"
        return held.received

    def close(self, name: str) -> None:
        """Close it, if it is open."""
        self._failed.discard(name)
        held = self._sockets.pop(name, None)
        if held is not None:
            with contextlib.suppress(OSError):
                held.link.close()

    def close_all(self) -> None:
        """Close every one."""
        for name in list(self._sockets):
            self.close(name)

    def _fail(self, name: str) -> None:
        self.close(name)
        self._failed.add(name)

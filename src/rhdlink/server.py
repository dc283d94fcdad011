"""The sockets of a host, served between two ticks and never longer.

Nothing here waits for a client: what has come is taken, what a client has not read waits in memory, within bounds. What
the bytes mean is the business of `service`.
"""

from __future__ import annotations

import contextlib
import logging
import select
import selectors
import socket
import struct
import time
from collections.abc import Callable

from linkcore.errors import BadAddress

from .service import Guest, Service

__all__ = ["Server"]

_log = logging.getLogger(__name__)

#: Connections that may be in the middle of their handshake; the oldest goes when there are more.
MOST_NEW = 32
#: Bytes taken from a client at a time.
_CHUNK = 1 << 16
# Seconds between two looks for clients that owe something, at most.
_LOOK = 0.5
# Bytes that the kernel may hold for a client. Left to itself it grows to megabytes: seconds of old news.
_KERNEL_BUFFER = 1 << 18
# Descriptors that select takes.
_SELECTABLE = 1024
# Closing with this option set resets the connection.
_RESET = struct.pack("ii", 1, 0)


class _Link:
    """One connection: its socket, what waits to be sent, and since when it owes something.

    It owes while its handshake or a request is begun and not complete, and while it does not read.
    """

    def __init__(self, connection: socket.socket, guest: Guest) -> None:
        self.socket = connection
        self.guest = guest
        self.pending = b""
        self.owes_since: float | None = time.monotonic()
        self.requests = 0
        self.is_open = True
        self.mask = selectors.EVENT_READ


class Server:
    """Listens, and carries bytes between the connections and a service.

    Args:
        service: what the bytes mean.
        host: address to listen on.
        port: number, or 0 for a free one.
        patience: seconds that a client may owe something before its connection is closed.

    Attributes:
        port: the number listened on.

    Raises:
        BadAddress: that cannot be listened on.
    """

    def __init__(self, service: Service, host: str, port: int, *, patience: float) -> None:
        self._service = service
        self._patience = patience
        self._links: dict[Guest, _Link] = {}
        self._new: dict[Guest, _Link] = {}
        self._looked = time.monotonic()
        self._look = min(_LOOK, patience / 4)
        self._listener = _listening(host, port)
        self.port: int = self._listener.getsockname()[1]
        self._waker, self._woken = socket.socketpair()
        self._waker.setblocking(False)
        self._woken.setblocking(False)
        self._selector = selectors.DefaultSelector()
        self._selector.register(self._listener, selectors.EVENT_READ, self._accept)
        self._selector.register(self._woken, selectors.EVENT_READ, self._be_woken)
        # The selector of Linux waits in whole milliseconds, too coarse for a tick of two. But it is a descriptor
        # itself, and select, which can be told microseconds, waits for it; unless it has a number too high for select.
        fileno = getattr(self._selector, "fileno", int)()
        self._select_from = (fileno,) if 0 < fileno < _SELECTABLE else None

    def wake(self) -> None:
        """End a `serve` that waits; from any thread."""
        # A full pipe wakes as well; a closed one belongs to a server that has ended.
        with contextlib.suppress(OSError):
            self._waker.send(b"\0")

    def serve(self, until: float | None, is_enough: Callable[[], bool]) -> None:
        """Serve sockets until the monotonic time `until`, or until it is enough, whichever comes first.

        What has come already is always looked at once; each look is followed by one at the clock.
        """
        timeout = 0.0
        while True:
            for key, mask in self._events(timeout):
                key.data(key, mask)
                if until is not None and time.monotonic() >= until:
                    break
            if is_enough():
                return
            now = time.monotonic()
            if now - self._looked >= self._look:
                self._close_debtors(now)
            if until is not None and now >= until:
                return
            timeout = self._look if until is None else min(until - now, self._look)

    def _events(self, timeout: float) -> list[tuple[selectors.SelectorKey, int]]:
        if timeout <= 0.0:
            return self._selector.select(0)
        if timeout >= self._look or self._select_from is None:
            # Rounded up to a millisecond; the caller looks at the clock.
            return self._selector.select(timeout)
        if select.select(self._select_from, (), (), timeout)[0]:
            return self._selector.select(0)
        return []

    def send(self, guest: Guest, data: bytes) -> None:
        """Send, now what the connection takes, and later what it does not."""
        link = self._links.get(guest)
        if link is None or not link.is_open:
            return
        if not link.pending:
            try:
                sent = link.socket.send(data)
            except BlockingIOError:
                sent = 0
            except OSError as error:
                self._drop(link, str(error.strerror or error))
                return
            if sent == len(data):
                return
            data = data[sent:]
        # The service asks for no more while this waits, so it is one handshake and one batch at most.
        link.pending += data
        guest.is_reading = False
        self._owe(link)
        self._watch(link)

    def resume(self) -> None:
        """After a sync: read again from those who had sent ahead, and close those who sent what cannot be."""
        for link in list(self._links.values()):
            if link.guest.failure is not None:
                self._drop(link, link.guest.failure)
                continue
            if not link.mask & selectors.EVENT_READ and link.guest.wants_more:
                self._watch(link)
            self._owe(link)

    def close(self) -> None:
        """Close all connections and the port; idempotent."""
        for link in list(self._links.values()):
            self._drop(link, "the host ends", is_news=False)
        self._listener.close()
        self._selector.close()
        self._waker.close()
        self._woken.close()

    # -- events --------------------------------------------------------------------------------------

    def _be_woken(self, key: selectors.SelectorKey, mask: int) -> None:
        with contextlib.suppress(BlockingIOError):
            self._woken.recv(4096)

    def _accept(self, key: selectors.SelectorKey, mask: int) -> None:
        try:
            connection, address = self._listener.accept()
        except OSError:
            return  # It was there and is gone, or there are no descriptors left.
        connection.setblocking(False)
        with contextlib.suppress(OSError):
            # Or a reply to the second of two requests waits for the acknowledgement of the first (section 1).
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _KERNEL_BUFFER)
            # A master that lost power sends no FIN.
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        guest = self._service.arrive(_name(address))
        if guest is None:
            # All seats are taken: closed at once and without a byte, as the original does (section 3).
            connection.close()
            return
        if len(self._new) >= MOST_NEW:
            self._drop(next(iter(self._new.values())), "too many in the middle of a handshake")
        link = _Link(connection, guest)
        self._links[guest] = self._new[guest] = link
        self._selector.register(connection, link.mask, lambda key, mask: self._serve(link, mask))

    def _serve(self, link: _Link, mask: int) -> None:
        if mask & selectors.EVENT_WRITE and link.is_open:
            self._flush(link)
        if mask & selectors.EVENT_READ and link.is_open:
            self._receive(link)

    def _flush(self, link: _Link) -> None:
        try:
            sent = link.socket.send(link.pending)
        except BlockingIOError:
            return
        except OSError as error:
            self._drop(link, str(error.strerror or error))
            return
        link.pending = link.pending[sent:]
        link.owes_since = time.monotonic()  # it reads, if slowly
        if not link.pending:
            link.guest.is_reading = True
            self._owe(link)
            self._watch(link)

    def _receive(self, link: _Link) -> None:
        try:
            data = link.socket.recv(_CHUNK)
        except BlockingIOError:
            return
        except OSError as error:
            self._drop(link, str(error.strerror or error), is_news=False)
            return
        if not data:
            self._drop(link, "closed by the client", is_news=False)
            return
        guest = link.guest
        answer = self._service.receive(guest, data)
        if guest.failure is not None:
            self._drop(link, guest.failure)
            return
        if answer:
            self._new.pop(guest, None)
            self.send(guest, answer)
        self._owe(link)
        if not guest.wants_more:
            self._watch(link)

    def _watch(self, link: _Link) -> None:
        """Wait for what this connection can do next."""
        if not link.is_open:
            return
        mask = (selectors.EVENT_READ if link.guest.wants_more else 0) | (selectors.EVENT_WRITE if link.pending else 0)
        if mask == link.mask:
            return
        if not mask:
            self._selector.unregister(link.socket)
        elif not link.mask:
            self._selector.register(link.socket, mask, lambda key, mask: self._serve(link, mask))
        else:
            self._selector.modify(link.socket, mask, lambda key, mask: self._serve(link, mask))
        link.mask = mask

    # -- who owes, and who goes ------------------------------------------------------------------------

    def _owe(self, link: _Link) -> None:
        """Note when a debt begins; a part payment does not begin it anew, a request that is complete does."""
        if not link.pending and not link.guest.is_midway:
            link.owes_since = None
        elif link.owes_since is None or link.requests != link.guest.requests:
            link.requests = link.guest.requests
            link.owes_since = time.monotonic()

    def _close_debtors(self, now: float) -> None:
        self._looked = now
        for link in list(self._links.values()):
            if link.owes_since is not None and now - link.owes_since > self._patience:
                what = "did not read" if link.pending else "left something half sent"
                self._drop(link, f"{what} for {self._patience:g} s")

    def _drop(self, link: _Link, reason: str, *, is_news: bool = True) -> None:
        if not link.is_open:
            return
        link.is_open = False
        _log.log(logging.WARNING if is_news else logging.INFO, "%s: %s", link.guest.name, reason)
        self._links.pop(link.guest, None)
        self._new.pop(link.guest, None)
        self._service.leave(link.guest)
        if link.mask:
            self._selector.unregister(link.socket)
        if is_news:
            with contextlib.suppress(OSError):
                link.socket.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _RESET)
        link.socket.close()


def _listening(host: str, port: int) -> socket.socket:
    listener = None
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        listener = socket.socket(family, kind, protocol)
        listener.setblocking(False)
        # A host that is started again finds its port free although old connections linger (defect 12). On Windows
        # the option means something else, and is not needed.
        if hasattr(socket, "SO_EXCLUSIVEADDRUSE"):
            listener.setsockopt(socket.SOL_SOCKET, socket.SO_EXCLUSIVEADDRUSE, 1)
        else:
            listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind(address)
        listener.listen(64)
    except (OSError, OverflowError, UnicodeError) as error:
        if listener is not None:
            listener.close()
        reason = getattr(error, "strerror", None) or error
        raise BadAddress(f"cannot listen on {host}:{port}: {reason}") from None
    return listener


def _name(address: object) -> str:
    return f"{address[0]}:{address[1]}" if isinstance(address, tuple) and len(address) >= 2 else "a client"

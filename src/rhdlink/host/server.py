"""Schedule of the ticks of a host, and the server for its connections, which are served between two ticks.

The bytes of `service` are sent and received with linkcore's selector loop, at most until the next tick. No code here
waits for a client. Data that a client has not read are kept in memory. They never exceed the client's handshake or one
batch, because no more requests of the client are processed until it has read these data. A client has `client_timeout`
seconds to complete a message that it has begun to send, and to read data sent to it. More bytes of the same request do
not extend this time.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Callable

import numpy as np

from linkcore.net.loop import Connection, Handler, SelectorLoop
from linkcore.threads import Newest

from .service import Client, Service

#: Number of ticks whose delay is stored for the percentiles.
_REMEMBERED = 4096


class TickSchedule:
    """Schedule of ticks at a fixed period.

    Each tick is due at its own absolute time, so that delays do not add up. A tick that is more than a period late
    counts as an overrun. The periods that this tick has missed are skipped and counted, but not repeated, because with
    three ticks in a row, a robot would make three steps at once.

    Args:
        period: Period in seconds.
        now: Time of the beginning.

    Attributes:
        due: Time when the next tick is due.
        overruns: Number of ticks that were more than a period late.
        skipped: Number of periods without a tick.
        worst: Longest delay of a tick, in seconds.
    """

    def __init__(self, period: float, now: float) -> None:
        self.due = now
        self.overruns = 0
        self.skipped = 0
        self.worst = 0.0
        self._period = period
        # The thread of the host adds the delays.
        self._late: Newest[float] = Newest(_REMEMBERED)

    def advance(self) -> float:
        """Advance to the next tick, and return the time when it is due."""
        self.due += self._period
        return self.due

    def postpone(self, seconds: float) -> None:
        """Postpone the tick, because the host waits for it on purpose; it does not count as late then."""
        self.due += max(seconds, 0.0)

    def came(self, now: float) -> None:
        """Record that the tick has come."""
        late = now - self.due
        self._late.add(late)
        self.worst = max(self.worst, late)
        if late > self._period:
            periods = int(late / self._period)
            self.overruns += 1
            self.skipped += periods
            self.due += periods * self._period

    def lateness(self) -> tuple[float, float]:
        """Return the median and the 99th percentile of the last 4096 delays, in seconds. Callable from any thread."""
        late = self._late.copy()
        if not late:
            return 0.0, 0.0
        median, p99 = np.percentile(late, (50, 99)).tolist()
        return median, p99


_log = logging.getLogger(__name__)

#: Maximum number of connections in the middle of their handshake; if there are more, the oldest is closed.
MOST_NEW = 32


class Server:
    """Server that listens on a port, and transfers bytes between connections and a service.

    Args:
        service: Service that interprets the bytes.
        host: Address to listen on.
        port: Port number; 0 for a free one.
        client_timeout: Time, in seconds, for which a client may leave a message incomplete or unread.
        inactivity_timeout: Time without a request, in seconds, after which a reader may lose its slot to a new client.

    Attributes:
        port: Port number that it listens on.
        evicted: Number of readers that lost their slot.

    Raises:
        BadAddress: If the server cannot listen on the address.
    """

    def __init__(
        self, service: Service, host: str, port: int, *, client_timeout: float, inactivity_timeout: float
    ) -> None:
        self.evicted = 0
        self._is_closing = False
        self._service = service
        self._client_timeout = client_timeout
        self._inactivity_timeout = inactivity_timeout
        self._handlers: dict[Client, _ClientHandler] = {}
        self._loop = SelectorLoop()
        # The service counts its slots and knows idle clients. `_accept` refuses a client if no slot is free, and at
        # most MOST_NEW clients are in their handshake. Therefore the loop's own limit is never reached.
        try:
            listening = self._loop.listen(
                host,
                port,
                self._accept,
                limit=service.slots + MOST_NEW,
                idle=math.inf,
                output_limit=service.most_output,
            )
        except BaseException:
            self._loop.close()
            raise
        self.port = listening.number

    def wake(self) -> None:
        """End a waiting `serve`; callable from any thread, and from signal handlers."""
        self._loop.wake()

    def serve(self, until: float | None, is_enough: Callable[[], bool]) -> None:
        """Serve sockets until the monotonic time `until`, or until `is_enough` returns true, whichever comes first.

        Data that have already arrived are processed once in any case.
        """
        # First serve without waiting, because a request that was sent before the previous reply may already be enough.
        self._loop.serve_once(self._loop.time())
        while not is_enough() and (until is None or self._loop.time() < until):
            self._loop.serve_once(until)

    def send(self, client: Client, data: bytes) -> None:
        """Send a reply, immediately as far as the connection accepts it, and the rest later; then call `resume`."""
        handler = self._handlers.get(client)
        if handler is not None:
            handler.send(data)

    def resume(self) -> None:
        """Update all clients after a sync and its replies.

        Read again from clients that have sent requests ahead of the replies, restart the timeout of clients that did
        not read, and close clients that have sent invalid data.
        """
        for handler in list(self._handlers.values()):
            handler.update()

    def close(self) -> None:
        """Close all connections and the port; idempotent."""
        self._is_closing = True
        self._loop.close()

    def _accept(self, connection: Connection) -> Handler | None:
        if self._service.is_full:
            self._evict()
        client = self._service.connect(connection.name)
        if client is None:
            # Close the connection immediately and without a byte, as in the original (docs/protocols/rhd.md,
            # Handshake).
            return None
        new = [handler for handler in self._handlers.values() if handler.client.access is None]
        if len(new) >= MOST_NEW:
            new[0].close("too many clients in the middle of a handshake")
        return _ClientHandler(self, connection, client)

    def _evict(self) -> None:
        """Free the slot of the reader with the oldest last request, if that request is old enough."""
        readers = [handler for client, handler in self._handlers.items() if client.access == "r"]
        if not readers:
            return
        idlest = min(readers, key=lambda handler: handler.asked)
        idle = self._loop.time() - idlest.asked
        if idle >= self._inactivity_timeout:
            self.evicted += 1
            idlest.close(f"sent no request for {idle:.0f} s, and its slot is needed")


class _ClientHandler(Handler):
    """Handler of one connection.

    Attributes:
        asked: Time of the client's last complete request, or of its handshake, on the loop's clock; unset before the
            handshake.
    """

    asked: float

    def __init__(self, server: Server, connection: Connection, client: Client) -> None:
        self.connection = connection
        self.client = client
        self._server = server
        self._time = server._loop.time
        self._requests = client.requests
        self._lacking = ""
        server._handlers[client] = self
        self.update()

    def data_received(self, data: bytes) -> None:
        answer = self._server._service.receive(self.client, data)
        if answer:
            self.asked = self._time()
            self.send(answer)
        self.update()

    def drained(self) -> None:
        self.client.is_reading = True
        self.update()

    def connection_lost(self, reason: str, *, by_peer: bool) -> None:
        is_expected = by_peer or self._server._is_closing
        _log.log(logging.INFO if is_expected else logging.WARNING, "%s: %s", self.client.name, reason)
        self.leave()

    def send(self, data: bytes) -> None:
        self.connection.write(data)
        if self.connection.pending:
            self.client.is_reading = False  # the service asks for no more while data are pending

    def update(self) -> None:
        """Apply the state of the client: close the connection, start or stop reading, and start or stop the timeout."""
        client, connection = self.client, self.connection
        if not connection.is_open:
            return
        if client.failure is not None:
            self.close(client.failure)
            return
        (connection.resume_reading if client.may_send else connection.pause_reading)()
        if client.requests != self._requests:
            self._requests, self.asked = client.requests, self._time()
        lacking = (
            "did not read" if not client.is_reading else "left a message incomplete" if client.is_incomplete else ""
        )
        # The time starts with the first byte of a request, and later bytes do not restart it. Otherwise a client that
        # sends one byte from time to time would keep its connection forever.
        if lacking == self._lacking:
            return
        self._lacking = lacking
        if lacking:
            timeout = self._server._client_timeout
            connection.set_deadline(self._time() + timeout, f"{lacking} for {timeout:g} s")
        else:
            connection.clear_deadline()

    def close(self, reason: str) -> None:
        """Close the connection, and release its slot immediately."""
        self.connection.close(reset=True, reason=reason)
        self.leave()

    def leave(self) -> None:
        """Remove the client, which has disconnected. Idempotent."""
        if self._server._handlers.pop(self.client, None) is not None:
            self._server._service.disconnect(self.client)

"""The ticks of a host, when each is due and how late it came, and its connections, which are served between two ticks.

What `service` decides goes over linkcore's selector loop, and never longer than to the next tick. Nothing here waits
for a client. What a client has not read waits in memory, its handshake or one batch, since it is asked for no more
until it has read that. A client has `client_timeout` seconds to complete what it has begun to send, and to read what
was sent to it; more bytes of the same request do not buy it more time.
"""

from __future__ import annotations

import logging
import math
from collections import deque
from collections.abc import Callable

import numpy as np

from linkcore.net.loop import Connection, Handler, SelectorLoop

from .service import Client, Service

#: Ticks whose lateness is remembered for its percentiles.
_REMEMBERED = 4096


class TickSchedule:
    """Ticks at a period.

    Each is due at its own absolute time, so that lateness does not add up. A tick that comes more than a period late
    is counted as an overrun; the whole periods that it missed are skipped and counted, and not made up for, since a
    robot that gets three ticks in a row would take three steps at once.

    Args:
        period: seconds.
        now: when it begins.

    Attributes:
        due: when the next tick is due.
        overruns: ticks that came more than a period late.
        skipped: periods without a tick.
        worst: seconds by which the latest of all came after it was due.
    """

    def __init__(self, period: float, now: float) -> None:
        self.due = now
        self.overruns = 0
        self.skipped = 0
        self.worst = 0.0
        self._period = period
        self._late: deque[float] = deque(maxlen=_REMEMBERED)

    def advance(self) -> float:
        """Go on to the next tick; when it is due."""
        self.due += self._period
        return self.due

    def postpone(self, seconds: float) -> None:
        """The tick is waited for by the host, and is not late because of that."""
        self.due += max(seconds, 0.0)

    def came(self, now: float) -> None:
        """The tick has come."""
        late = now - self.due
        self._late.append(late)
        self.worst = max(self.worst, late)
        if late > self._period:
            periods = int(late / self._period)
            self.overruns += 1
            self.skipped += periods
            self.due += periods * self._period

    def lateness(self) -> tuple[float, float]:
        """Seconds, of the last 4096 ticks: the median, and what one in a hundred exceeds. From any thread."""
        # The host's thread may be adding to it. A deque is copied in one go, where going through it would fail then.
        late = list(self._late.copy())
        if not late:
            return 0.0, 0.0
        median, p99 = np.percentile(late, (50, 99)).tolist()
        return median, p99


_log = logging.getLogger(__name__)

#: Connections that may be in the middle of their handshake; the oldest goes when there are more.
MOST_NEW = 32


class Server:
    """Listens, and carries bytes between the connections and a service.

    Args:
        service: what the bytes mean.
        host: address to listen on.
        port: number, or 0 for a free one.
        client_timeout: seconds that a client may leave something half sent or unread.
        inactivity_timeout: seconds without a request after which a reader may lose its slot to a newcomer.

    Attributes:
        port: the number listened on.
        evicted: readers that lost their slot.

    Raises:
        BadAddress: that cannot be listened on.
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
        # The service knows its slots and which clients idle. `_accept` refuses a client where no slot is free, and at
        # most MOST_NEW are in their handshake: there are fewer connections than the limit, so the loop refuses none.
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
        """End a `serve` that waits; from any thread, and from signal handlers."""
        self._loop.wake()

    def serve(self, until: float | None, is_enough: Callable[[], bool]) -> None:
        """Serve sockets until the monotonic time `until`, or until it is enough, whichever comes first.

        What has come already is looked at once in any case.
        """
        # First without waiting: it may be enough already, by a request that was sent ahead of the reply before it.
        self._loop.serve_once(self._loop.time())
        while not is_enough() and (until is None or self._loop.time() < until):
            self._loop.serve_once(until)

    def send(self, client: Client, data: bytes) -> None:
        """Send a reply, now what the connection takes, and later what it does not; `resume` has to follow."""
        handler = self._handlers.get(client)
        if handler is not None:
            handler.send(data)

    def resume(self) -> None:
        """After a sync and its replies: read again from clients that had sent ahead, give time to those that did not
        read, and close those that sent invalid data.
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
            # Closed at once and without a byte, as the original does (docs/protocols/rhd.md, Handshake).
            return None
        new = [handler for handler in self._handlers.values() if handler.client.access is None]
        if len(new) >= MOST_NEW:
            new[0].close("too many in the middle of a handshake")
        return _ClientHandler(self, connection, client)

    def _evict(self) -> None:
        """Take the slot of the reader whose last request is the longest ago, if that is long enough."""
        readers = [handler for client, handler in self._handlers.items() if client.access == "r"]
        if not readers:
            return
        idlest = min(readers, key=lambda handler: handler.asked)
        idle = self._loop.time() - idlest.asked
        if idle >= self._inactivity_timeout:
            self.evicted += 1
            idlest.close(f"asked for nothing for {idle:.0f} s, and its slot is needed")


class _ClientHandler(Handler):
    """One connection.

    Attributes:
        asked: when its newest request, or its handshake, was complete, on the loop's clock; not before its handshake.
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
            self.client.is_reading = False  # the service asks for no more while this waits

    def update(self) -> None:
        """Do what the client's state asks for: close it, read from it or not, let its time run or not."""
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
            "did not read" if not client.is_reading else "left something half sent" if client.is_incomplete else ""
        )
        # Time begins with the first byte of a request, and bytes that follow do not begin it anew: a client that sends
        # one byte now and then would hold its connection for ever.
        if lacking == self._lacking:
            return
        self._lacking = lacking
        if lacking:
            timeout = self._server._client_timeout
            connection.set_deadline(self._time() + timeout, f"{lacking} for {timeout:g} s")
        else:
            connection.clear_deadline()

    def close(self, reason: str) -> None:
        """Close the connection, and give its slot to others at once."""
        self.connection.close(reset=True, reason=reason)
        self.leave()

    def leave(self) -> None:
        """The client is gone. Idempotent."""
        if self._server._handlers.pop(self.client, None) is not None:
            self._server._service.disconnect(self.client)

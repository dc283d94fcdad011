"""One connection to a server: handshake, and a batch for each request, in step."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from linkcore import clock
from linkcore.clock import Stamp
from linkcore.errors import ConnectFailed, ConnectionLost, LinkTimeout, PacketError, WrongPeer
from linkcore.pending_call import check_wanted

from .errors import AccessDenied
from .wire.decoder import Limits, ServerDecoder
from .wire.messages import END, Batch, Handshake, encode_access, encode_ready

#: Seconds that the unsolicited batch is waited for at most, once in a connection. Robots tick every 10 to 25 ms
#: (docs/protocols/rhd.md, Configuration file), so this covers four ticks of the slowest.
_MOST_UNSOLICITED_WAIT = 0.1


class Transport(Protocol):
    """The transport of a connection: `linkcore.net.transport.TcpTransport`."""

    name: str

    def open(self, timeout: float) -> None:
        """Connect."""

    def receive(self, timeout: float | None = None) -> tuple[bytes, Stamp]:
        """Wait for bytes."""

    def receive_waiting(self) -> tuple[bytes, Stamp] | None:
        """Bytes that have come already."""

    def send(self, data: bytes, timeout: float) -> None:
        """Send all of it."""

    def abort(self) -> None:
        """Disconnect at once: bytes that the peer has not acknowledged are discarded. Wakes waiting threads."""

    def close(self) -> None:
        """Disconnect; waits a moment for the peer to acknowledge what was sent. Wakes waiting threads."""


class Connection:
    """A connection that has been granted access.

    A server of the original sends one batch that nobody asked for, at its first tick after the handshake, unless a
    request reaches it before (docs/protocols/rhd.md, The unsolicited batch). A client that takes this batch for the
    reply to a request stays one reply behind for ever. Nothing in a batch says which it is, so replies are counted:
    those that are outstanding are waited for, and a batch that comes while none is outstanding is delivered and not
    counted.

    Args:
        transport: not yet open.
        access: to ask for, "r" or "w".
        fallback: "r" accepts reader access where there is a master already; else None.
        width: words of a time stamp; None finds out.
        limits: what the server may ask for.
        until: when the handshake has to be done, by `linkcore.clock.now`.

    Attributes:
        access: what was granted, "r" or "w".
        handshake: of the server.
        received: when the newest bytes came.

    Raises:
        AccessDenied: write access was refused, and there is no fallback.
        ConnectFailed, ConnectionLost, LinkTimeout: the server is not there, is gone, or is silent.
        WrongPeer: something else is listening.
        PacketError: what came is not a handshake.
    """

    def __init__(
        self,
        transport: Transport,
        *,
        access: str,
        fallback: str | None,
        width: int | None,
        limits: Limits | None,
        until: float,
        deliver: Callable[[Batch], object],
    ) -> None:
        self._transport = transport
        self._deliver = deliver
        self._width = width
        self._limits = limits
        self._outstanding = 0  # requests without a reply
        self._is_settled = False  # the unsolicited batch has come, or will not come any more
        self._has_answered = False
        try:
            self._greet(access, until)
            if self.handshake.granted != access:
                if fallback != "r":
                    raise AccessDenied(f"{transport.name} refuses write access; it has a master already")
                if self.handshake.granted != "r":
                    # The original names no access when it refuses. It would serve this connection all the same, but
                    # only by an oversight (docs/protocols/rhd.md, Access): ask again, as a reader.
                    self._greet("r", until)
                    if self.handshake.granted != "r":
                        raise AccessDenied(f"{transport.name} refuses even reader access")
        except BaseException:
            transport.abort()
            raise

    def _greet(self, access: str, until: float) -> None:
        transport = self._transport
        transport.open(_left(until))
        self._decoder = decoder = ServerDecoder(width=self._width, limits=self._limits)
        handshake = None
        try:
            transport.send(encode_access(access), _left(until))
            while handshake is None:
                data, self.received = transport.receive(_left(until))
                decoder.feed(data)
                handshake = decoder.take_handshake()
        except ConnectionLost as error:
            if decoder.waiting:
                raise
            # A server without a free slot accepts and closes without a byte (docs/protocols/rhd.md, Handshake).
            raise ConnectFailed(f"{error} without a word; are all its client slots in use?") from error
        except LinkTimeout as error:
            raise LinkTimeout(f"{transport.name}: no handshake in time; {decoder.waiting} bytes of it came") from error
        except PacketError as error:
            # Wrong from the first byte on: an SSH or HTTP server, say, and not an RHD server that has gone astray.
            if error.offset == 0:
                raise WrongPeer(f"{transport.name} is no RHD server: {error.reason}") from error
            raise
        self.handshake: Handshake = handshake
        self.access = access if handshake.granted is None else handshake.granted

    @property
    def width(self) -> int:
        """Words of a time stamp."""
        return self.handshake.width

    def take_waiting(self, until: float) -> None:
        """Deliver the batches that have come already; does not wait.

        Raises:
            LinkTimeout: more and more of them come.
            ConnectionLost, PacketError: as `request`.
        """
        self._deliver_decoded()
        while (arrived := self._transport.receive_waiting()) is not None:
            self._take(*arrived)
            _left(until)

    def settle(self, period: float | None, until: float) -> None:
        """Make sure that the unsolicited batch is not still to come.

        Waits once in a connection, after the first answer. If that was the unsolicited batch, the reply to the request
        follows one tick later, and is delivered here. So a tick and a half has to pass without a batch.

        Args:
            period: seconds between ticks, as far as known.
            until: when to be done at the latest, by `linkcore.clock.now`.
        """
        if self._is_settled or self._outstanding or not self._has_answered:
            return
        seconds = _MOST_UNSOLICITED_WAIT if period is None else min(1.5 * period + 2e-3, _MOST_UNSOLICITED_WAIT)
        enough = clock.now() + seconds
        while not self._is_settled and (left := min(enough, until) - clock.now()) > 0:
            try:
                arrived = self._transport.receive(left)
            except LinkTimeout:
                break
            self._take(*arrived)
        if enough <= until:
            self._is_settled = True  # else there was no time to be sure; the next sync goes on

    def collect(self, until: float) -> None:
        """Wait for the replies that are outstanding, and deliver them.

        So no more than one request ever waits at a server: it would take one at each tick, and a program that is late
        would drive the robot by what it sent long ago.

        Raises:
            LinkTimeout: no reply in time; it stays outstanding.
            ConnectionLost: the connection is gone.
            PacketError: the reply cannot be understood.
        """
        # Set only when nothing is outstanding any more: until then it is not known which batch was whose.
        while self._outstanding:
            self._take(*self._transport.receive(_left(until)))
            self._has_answered = not self._outstanding

    def request(self, data: bytes, until: float) -> None:
        """Ask for a batch, and deliver it.

        Args:
            data: data packages to send with it.
            until: when to be done at the latest, by `linkcore.clock.now`.

        Raises:
            LinkTimeout: no reply in time; it stays outstanding.
            ConnectionLost: the connection is gone, or did not take the request.
            PacketError: the reply cannot be understood.
            Cancelled: this thread makes a call that was given up; nothing was sent.
        """
        check_wanted()
        try:
            self._transport.send(encode_ready(self.access) + data + END, clock.left(until))
        except LinkTimeout as error:
            # Half a request may have gone out: whatever followed would be taken for its other half.
            raise ConnectionLost(str(error)) from error
        except BaseException:  # interrupted: likewise
            self._transport.abort()
            raise
        self._outstanding += 1  # from now on, whatever comes: a timeout leaves the reply to the next sync
        self.collect(until)

    def abort(self) -> None:
        """Give the connection up: a request that is still in the kernel is never sent. Idempotent, from any thread."""
        self._transport.abort()

    def _take(self, data: bytes, received: Stamp) -> None:
        """Deliver the batches that these bytes complete."""
        self.received = received
        self._decoder.feed(data)
        self._deliver_decoded()

    def _deliver_decoded(self) -> None:
        while (batch := self._decoder.take_batch()) is not None:
            if self._outstanding:
                self._outstanding -= 1
            else:
                self._is_settled = True
            self._deliver(batch)


def _left(until: float) -> float:
    left = until - clock.now()
    if left <= 0:
        raise LinkTimeout("no time is left")
    return left

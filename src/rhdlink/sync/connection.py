"""Connection to a server, which performs the handshake and exchanges one batch per request."""

from __future__ import annotations

from collections.abc import Callable

from linkcore import clock
from linkcore.clock import Stamp
from linkcore.errors import ConnectFailed, ConnectionLost, LinkTimeout, PacketError, WrongPeer
from linkcore.pending_call import check_wanted

from ..errors import AccessDenied
from ..wire.decoder import Limits, ServerDecoder
from ..wire.messages import END, Batch, Handshake, encode_access, encode_ready
from ..wire.transport import Transport

#: Maximum wait for the unsolicited batch, in seconds, once per connection. Robots tick every 10 to 25 ms
#: (docs/protocols/rhd.md, Configuration file), so this covers four ticks of the slowest robot.
_MOST_UNSOLICITED_WAIT = 0.1


class Connection:
    """Connection to a server that has granted access.

    A server of the original sends one unsolicited batch at its first tick after the handshake, unless a request arrives
    before that tick (docs/protocols/rhd.md, The unsolicited batch). A client that takes this batch for the reply to a
    request stays one reply behind forever. A batch does not show whether it is a reply, so this class counts replies.
    It waits for outstanding replies. A batch that arrives while no reply is outstanding is delivered, but not counted.

    Args:
        transport: Transport that is not yet open.
        access: Requested access, "r" or "w".
        fallback: "r" accepts read access if the robot already has a master; otherwise None.
        width: Number of 32-bit words of a time stamp. If None, it is detected.
        limits: Limits on the data that the server may send.
        until: Deadline of the handshake, on the clock `linkcore.clock.now`.
        deliver: Function that is called with each batch.

    Attributes:
        access: Granted access, "r" or "w".
        handshake: Handshake of the server.
        received: Time at which the newest bytes arrived.

    Raises:
        AccessDenied: If the server refuses write access and there is no fallback.
        ConnectFailed: If no server is at the address, or the server has no free client slot.
        ConnectionLost: If the server closes the connection.
        LinkTimeout: If the server does not answer in time.
        WrongPeer: If the peer is not an RHD server.
        PacketError: If the received bytes are not a valid handshake.
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
        self._is_settled = False  # whether the unsolicited batch has arrived, or can no longer arrive
        self._has_answered = False
        try:
            self._greet(access, until)
            if self.handshake.granted != access:
                if fallback != "r":
                    raise AccessDenied(f"{transport.name} refuses write access because it already has a master")
                if self.handshake.granted != "r":
                    # The original names no access when it refuses write access. It would still serve this connection,
                    # but only because of a defect (docs/protocols/rhd.md, Access). So request access again, as a
                    # reader.
                    self._greet("r", until)
                    if self.handshake.granted != "r":
                        raise AccessDenied(f"{transport.name} refuses even read access")
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
            raise ConnectFailed(f"{error} before sending a byte; are all its client slots in use?") from error
        except LinkTimeout as error:
            raise LinkTimeout(
                f"{transport.name}: the handshake did not arrive in time; received {decoder.waiting} bytes of it"
            ) from error
        except PacketError as error:
            # An error at the first byte means another kind of server, such as SSH or HTTP, rather than a faulty RHD
            # server.
            if error.offset == 0:
                raise WrongPeer(f"{transport.name} is not an RHD server: {error.reason}") from error
            raise
        self.handshake: Handshake = handshake
        self.access = access if handshake.granted is None else handshake.granted

    @property
    def width(self) -> int:
        """Number of 32-bit words of a time stamp."""
        return self.handshake.width

    def take_waiting(self, until: float) -> None:
        """Deliver the batches that have already arrived, without waiting.

        Raises:
            LinkTimeout: If batches keep arriving until the deadline.
            ConnectionLost, PacketError: If receiving fails; see `request`.
        """
        self._deliver_decoded()
        while (arrived := self._transport.receive_waiting()) is not None:
            self._take(*arrived)
            _left(until)

    def settle(self, period: float | None, until: float) -> None:
        """Ensure that the unsolicited batch can no longer arrive.

        Wait once per connection, after the first answer. If that answer was the unsolicited batch, the reply to the
        request follows one tick later and is delivered here. So one and a half ticks must pass without a batch.

        Args:
            period: Seconds between ticks; None if unknown.
            until: Deadline, on the clock `linkcore.clock.now`.
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
            self._is_settled = True  # otherwise the time was too short to be sure, and the next sync continues

    def collect(self, until: float) -> None:
        """Wait for the outstanding replies and deliver them.

        This keeps at most one request pending at a server. The server takes one request per tick, so a client that
        falls behind would otherwise drive the robot with outdated values.

        Raises:
            LinkTimeout: If a reply does not arrive in time; it stays outstanding.
            ConnectionLost: If the connection is lost.
            PacketError: If the reply cannot be decoded.
        """
        # Set this only when no reply is outstanding, because until then it is unknown to which request a batch belongs.
        while self._outstanding:
            self._take(*self._transport.receive(_left(until)))
            self._has_answered = not self._outstanding

    def request(self, data: bytes, until: float) -> None:
        """Request a batch and deliver it.

        Args:
            data: Data packages to send with the request.
            until: Deadline, on the clock `linkcore.clock.now`.

        Raises:
            LinkTimeout: If the reply does not arrive in time; it stays outstanding.
            ConnectionLost: If the connection is lost, or the server does not accept the request.
            PacketError: If the reply cannot be decoded.
            Cancelled: If the call that this thread makes was cancelled. Nothing is sent.
        """
        check_wanted()
        try:
            self._transport.send(encode_ready(self.access) + data + END, clock.left(until))
        except LinkTimeout as error:
            # Half a request may have been sent; the server would read any following bytes as its second half.
            raise ConnectionLost(str(error)) from error
        except BaseException:  # an interrupted send has the same problem
            self._transport.abort()
            raise
        self._outstanding += 1  # from here on the reply is expected: after a timeout, the next sync waits for it
        self.collect(until)

    def abort(self) -> None:
        """Abort the connection.

        A request that is still in the kernel is never sent. Idempotent, from any thread.
        """
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
        raise LinkTimeout("no time left before the deadline")
    return left

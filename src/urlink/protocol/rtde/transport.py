"""RTDE connection as a source of bytes. It begins with a dialogue, and returns the bytes of the dialogue first.

Therefore a reader or a recorder of the stream receives every byte from the controller. The first bytes contain the
recipe.
"""

from __future__ import annotations

from collections import deque

from linkcore import clock
from linkcore.clock import Stamp
from linkcore.errors import LinkTimeout, PacketError
from linkcore.net.transport import Transport

from .packets import DataPackage
from .protocol import Requests, RtdeProtocol


class RtdeDialogue:
    """Dialogue at the beginning of a connection, up to the first data package, sans-IO.

    Args:
        plan: Variables to request.

    Attributes:
        protocol: Protocol of this connection.
        received: Received bytes.
    """

    def __init__(self, plan: Requests) -> None:
        self.protocol = RtdeProtocol(plan)
        self.received: deque[tuple[bytes, Stamp]] = deque()
        self._has_data = not plan.outputs

    @property
    def is_over(self) -> bool:
        """Whether all requests are answered and data has arrived."""
        return self.protocol.is_ready and self._has_data

    def receive(self, data: bytes, stamp: Stamp) -> None:
        """Process received bytes.

        Raises:
            WrongPeer: If the bytes are not from an RTDE server.
            RtdeRefused: If the controller refuses a request of the plan.
        """
        protocol = self.protocol
        self.received.append((data, stamp))
        for frame in protocol.framer.feed(data):
            try:
                packet = protocol.take(frame, stamp)
            except PacketError:
                continue  # the stream decodes this frame again, and counts the error
            self._has_data = self._has_data or (protocol.is_ready and isinstance(packet, DataPackage))

    def unanswered(self, name: str, timeout: float) -> LinkTimeout:
        """Return the error to raise after the timeout."""
        return LinkTimeout(f"{name}: no {self.protocol.awaits} arrived within {timeout:g} s")


class RtdeTransport:
    """Transport that sends the requests of a plan each time it connects.

    Args:
        transport: Transport of the bytes.
        plan: Variables to request.

    Attributes:
        dialogue: Protocol of the current connection, in its state after all replies.
    """

    def __init__(self, transport: Transport, plan: Requests) -> None:
        self.name = transport.name
        self.dialogue: RtdeProtocol | None = None
        self._transport = transport
        self._plan = plan
        self._first: deque[tuple[bytes, Stamp]] = deque()
        self.send = transport.send
        self.send_some = transport.send_some
        self.wait_for_room = transport.wait_for_room
        self.abort = transport.abort
        self.close = transport.close
        # Only a TCP connection can be simulated.
        self.accept_deferred = getattr(transport, "accept_deferred", None)

    @property
    def round_trip(self) -> float:
        """See `Transport.round_trip`."""
        return self._transport.round_trip

    @property
    def delivers_deferred(self) -> bool:
        """See `linkcore.net.transport.TcpTransport`."""
        return getattr(self._transport, "delivers_deferred", False)

    def open(self, timeout: float) -> None:
        """Connect, send the requests of the plan, and wait up to `timeout` seconds for the first data package.

        Raises:
            ConnectFailed: If the controller cannot be reached.
            ConnectionLost: If the connection is lost.
            WrongPeer: If another service answers.
            LinkTimeout: If a reply does not arrive in time. The error names the reply.
            RtdeRefused: If the controller refuses a request of the plan.
        """
        until = clock.now() + timeout
        self._transport.open(timeout)
        dialogue = RtdeDialogue(self._plan)
        try:
            while not dialogue.is_over:
                if requests := dialogue.protocol.requests():
                    self._transport.send(requests, clock.left(until))
                try:
                    dialogue.receive(*self._transport.receive(max(until - clock.now(), 0.001)))
                except LinkTimeout:
                    raise dialogue.unanswered(self.name, timeout) from None
                if clock.now() > until and not dialogue.protocol.is_ready:
                    raise dialogue.unanswered(self.name, timeout)
            self._begin(dialogue)
        except BaseException:
            self._transport.abort()
            raise

    def _begin(self, dialogue: RtdeDialogue) -> None:
        """Return the bytes that were received in the dialogue first, and later bytes after them."""
        self._first = dialogue.received
        self.dialogue = dialogue.protocol

    def receive(self, timeout: float | None = None) -> tuple[bytes, Stamp]:
        """See `Transport.receive`."""
        return self._first.popleft() if self._first else self._transport.receive(timeout)

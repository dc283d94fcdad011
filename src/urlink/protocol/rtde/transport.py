"""An RTDE connection as a source of bytes: it is made by a dialogue, and gives the bytes of that first.

So whoever reads the stream, or records it, gets every byte that the controller sent, the recipe in the first of them.
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
    """What is sent and received as a connection begins, until the first data package, sans-IO.

    Args:
        plan: what is asked for.

    Attributes:
        protocol: of this connection.
        received: what has come.
    """

    def __init__(self, plan: Requests) -> None:
        self.protocol = RtdeProtocol(plan)
        self.received: deque[tuple[bytes, Stamp]] = deque()
        self._has_data = not plan.outputs

    @property
    def is_over(self) -> bool:
        """Everything that was asked for is answered, and data has come."""
        return self.protocol.is_ready and self._has_data

    def receive(self, data: bytes, stamp: Stamp) -> None:
        """Bytes have come.

        Raises:
            WrongPeer: no controller sends such.
            RtdeRefused: the controller does not do what the plan asks for.
        """
        protocol = self.protocol
        self.received.append((data, stamp))
        for frame in protocol.framer.feed(data):
            try:
                packet = protocol.take(frame, stamp)
            except PacketError:
                continue  # the stream gets it too, and counts it
            self._has_data = self._has_data or (protocol.is_ready and isinstance(packet, DataPackage))

    def unanswered(self, name: str, timeout: float) -> LinkTimeout:
        """What to raise when time is up."""
        return LinkTimeout(f"{name}: waited {timeout:g} s for {self.protocol.awaits} in vain")


class RtdeTransport:
    """A transport that asks for what the plan says each time it connects.

    Args:
        transport: of the bytes.
        plan: what is asked for.

    Attributes:
        dialogue: the protocol of the present connection as it was when everything was answered.
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

    @property
    def round_trip(self) -> float:
        """See `Transport.round_trip`."""
        return self._transport.round_trip

    def open(self, timeout: float) -> None:
        """Connect, ask for what the plan says, and wait for the first data package, within `timeout` seconds.

        Raises:
            ConnectFailed, ConnectionLost, WrongPeer: nobody, or somebody else, is there.
            LinkTimeout: an answer did not come in time; says which.
            RtdeRefused: the controller does not do what the plan asks for.
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
        """All is answered: give what has come, and then what comes."""
        self._first = dialogue.received
        self.dialogue = dialogue.protocol

    def receive(self, timeout: float | None = None) -> tuple[bytes, Stamp]:
        """See `Transport.receive`."""
        return self._first.popleft() if self._first else self._transport.receive(timeout)

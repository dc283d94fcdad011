"""An RTDE connection as a source of bytes: it is made by a dialogue, and gives the bytes of that first.

So whoever reads the stream, or records it, gets every byte that the controller sent, the recipe in the first of them.
"""

from __future__ import annotations

import time
from collections import deque

from linkcore.errors import LinkTimeout, PacketError
from linkcore.net.transport import Transport
from linkcore.stamp import Stamp

from .packets import DataPackage
from .protocol import Plan, RtdeProtocol

__all__ = ["RtdeTransport"]


class RtdeTransport:
    """A transport that asks for what the plan says each time it connects.

    Args:
        transport: of the bytes.
        plan: what is asked for.

    Attributes:
        dialogue: the protocol of the present connection as it was when everything was answered.
    """

    def __init__(self, transport: Transport, plan: Plan) -> None:
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

    def open(self, timeout: float) -> None:
        """Connect, ask for what the plan says, and wait for the first data package, within `timeout` seconds.

        Raises:
            ConnectFailed, ConnectionLost, WrongPeer: nobody, or somebody else, is there.
            LinkTimeout: an answer did not come in time; says which.
            RtdeRefused: the controller does not do what the plan asks for.
        """
        until = time.monotonic() + timeout
        self._transport.open(timeout)
        try:
            self._ask(until, timeout)
        except BaseException:
            self._transport.abort()
            raise

    def _ask(self, until: float, timeout: float) -> None:
        protocol = RtdeProtocol(self._plan)
        first: deque[tuple[bytes, Stamp]] = deque()
        has_data = not self._plan.outputs
        while not (protocol.is_ready and has_data):
            requests = protocol.requests()
            if requests:
                self._transport.send(requests, max(until - time.monotonic(), 0.0))
            try:
                data, stamp = self._transport.receive(max(until - time.monotonic(), 0.001))
            except LinkTimeout:
                raise LinkTimeout(f"{self.name}: waited {timeout:g} s for {protocol.awaits} in vain") from None
            first.append((data, stamp))
            for frame in protocol.framer.feed(data):
                try:
                    packet = protocol.take(frame, stamp)
                except PacketError:
                    continue  # the stream gets it too, and counts it
                has_data = has_data or (protocol.is_ready and isinstance(packet, DataPackage))
            if time.monotonic() > until and not protocol.is_ready:
                raise LinkTimeout(f"{self.name}: waited {timeout:g} s for {protocol.awaits} in vain")
        self._first = first
        self.dialogue = protocol

    def receive(self, timeout: float | None = None) -> tuple[bytes, Stamp]:
        """See `Transport.receive`."""
        return self._first.popleft() if self._first else self._transport.receive(timeout)

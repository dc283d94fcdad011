"""An RTDE connection that is made and read by an event loop."""

from __future__ import annotations

import time

from linkcore.errors import LinkTimeout
from linkcore.net.awaited import AwaitedTcp
from linkcore.stamp import Stamp

from ..interfaces.rtde.protocol import Plan
from ..interfaces.rtde.transport import Dialogue, RtdeTransport

__all__ = ["AwaitedRtde"]


class AwaitedRtde(RtdeTransport):
    """As `RtdeTransport`, for an event loop.

    Args:
        transport: the TCP connection.
        plan: what to request.
    """

    def __init__(self, transport: AwaitedTcp, plan: Plan) -> None:
        super().__init__(transport, plan)
        self._tcp = transport
        self.fileno = transport.fileno
        self.disconnect = transport.disconnect

    async def connect(self, timeout: float) -> None:
        """Connect, request what the plan says, and wait for the first data package; see `RtdeTransport.open`."""
        until = time.monotonic() + timeout
        await self._tcp.connect(timeout)
        dialogue = Dialogue(self._plan)
        try:
            while not dialogue.is_over:
                # The first bytes on a connection: the buffer of the kernel has room for them.
                self._tcp.send(dialogue.requests(), 0.0)
                try:
                    dialogue.hear(*await self._tcp.receive_awaited(max(until - time.monotonic(), 0.001)))
                except LinkTimeout:
                    raise dialogue.unanswered(self.name, timeout) from None
                if time.monotonic() > until and not dialogue.is_answered:
                    raise dialogue.unanswered(self.name, timeout)
        except BaseException:
            self._tcp.abort()
            raise
        self._begin(dialogue)

    def receive_waiting(self) -> tuple[bytes, Stamp] | None:
        """See `AwaitedTransport.receive_waiting`."""
        return self._first.popleft() if self._first else self._tcp.receive_waiting()

"""The real-time interface (30003, 30013), sans-IO: bytes to `RealtimeState`."""

from __future__ import annotations

import logging
import struct
import weakref
from collections.abc import Callable

from linkcore.stamp import Stamp
from linkcore.wire.cycles import MissedCycles
from linkcore.wire.framing import Framer

from ...firmware import RELEASES
from .framing import RealtimeBoundary
from .packets import RealtimeState

__all__ = ["RealtimeProtocol", "periods_of"]

#: A packet begins with its size in four bytes, then its time.
_TIME = struct.Struct(">4xd")

_log = logging.getLogger(__name__)


class RealtimeProtocol:
    """Bytes in, typed states out; a new one for each connection."""

    #: ``decode(frame, stamp=None) -> RealtimeState``; raises `PacketError` if shorter than every layout
    decode: Callable[..., RealtimeState]

    def __init__(self) -> None:
        this = weakref.ref(self)  # which holds the boundary

        def learn(size: int) -> None:
            protocol = this()
            if protocol is not None:
                protocol._learn(size)

        self.framer = Framer(RealtimeBoundary(learn))
        self.cycles: MissedCycles | None = None  # known with the size
        self.unknown = 0
        self._size: int | None = None
        self._any = _AnyLayout()
        self.decode = self._any.decode

    @property
    def tails(self) -> int:
        """Packets that end in bytes which no known layout explains."""
        return self._any.tails

    def _learn(self, size: int) -> None:
        """The frame boundary has learnt the size of this connection's packets, and the size tells the layout."""
        if self.cycles is None:
            self.cycles = MissedCycles(_moment, periods_of(size), is_uniform=True)
        if all(layout.size != size for layout in RealtimeState.LAYOUTS.all):
            _log.warning("real-time packets of %d bytes: no such firmware is known; decoded as far as one is", size)
        elif self._size is None:
            self._size = size
            self.decode = RealtimeState.LAYOUTS.decoder(size) or self._any.decode
            return
        # An unknown size, or another than before: packets of both may wait to be decoded.
        self._size = 0
        self.decode = self._any.decode


class _AnyLayout:
    """Packets that go by their own length, and may have a tail. Not a method of the protocol, which would be in a
    reference cycle with it for as long as no packet has come.

    Attributes:
        tails: packets that have one.
    """

    def __init__(self) -> None:
        self.tails = 0

    def decode(self, frame: bytes, stamp: Stamp | None = None) -> RealtimeState:
        """The state in a packet."""
        state: RealtimeState = RealtimeState.LAYOUTS.decode(frame, None, stamp)
        self.tails += bool(state.tail)
        return state


def periods_of(size: int) -> tuple[float, ...]:
    """Seconds between two packets of this size; several, since some sizes are those of CB3 and of e-Series."""
    rates = {release.since.rate for release in RELEASES if release.realtime == size}
    return tuple(1.0 / rate for rate in rates or {RELEASES[-1].since.rate})


def _moment(frame: bytes) -> float:
    time: float = _TIME.unpack_from(frame)[0]
    return time

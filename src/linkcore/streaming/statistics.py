"""The counters of streams and subscriptions. Nothing disappears silently."""

from __future__ import annotations

import time
from dataclasses import dataclass

from ..stamp import Stamp
from ..wire.protocol import PacketProtocol

__all__ = ["StreamStatistics", "SubscriptionStatistics", "Tally"]


@dataclass(frozen=True)
class StreamStatistics:
    """Counters of one stream at one moment; ``received == delivered + dropped + failed`` always.

    Attributes:
        received: packets that came off the wire.
        delivered: packets that no subscription had to drop; they were, or still wait to be, handed
            to every subscriber.
        dropped: packets that at least one subscription dropped.
        failed: packets that could not be decoded.
        reconnects: connections after the first.
        rate: packets a second, over the last second or so; 0 in the first half second of a connection.
        bytes: bytes received.
        skipped: bytes thrown away while looking for a lost border.
        resyncs: lost borders found again.
        unknown: packets, or parts of one, of a type that no layout is known for.
        tails: packets, or parts of one, that end in bytes which no known layout explains.
        age: seconds since the last packet; None before the first one.
    """

    received: int
    delivered: int
    dropped: int
    failed: int
    reconnects: int
    rate: float
    bytes: int
    skipped: int
    resyncs: int
    unknown: int
    tails: int
    age: float | None


@dataclass(frozen=True)
class SubscriptionStatistics:
    """Counters of one subscription; ``received == delivered + dropped + failed + waiting``.

    Attributes:
        received: packets that it was offered and wanted.
        delivered: packets that its callback took, or that were fetched from it.
        dropped: packets thrown away, because it fell behind or was closed.
        failed: packets whose callback raised.
        waiting: packets in its queue, and the one in its callback.
        missed_deadlines: how often nothing came in time.
    """

    received: int
    delivered: int
    dropped: int
    failed: int
    waiting: int
    missed_deadlines: int


class Tally:
    """What the reader counts. Only the reader writes it, so it needs no lock.

    Attributes:
        received: packets that came off the wire.
    """

    def __init__(self) -> None:
        self.received = 0
        self._failed = 0
        self._bytes = 0
        self._connections = 0
        self._skipped = self._resyncs = self._unknown = self._tails = 0
        self._arrived: float | None = None
        self._window = (time.monotonic(), 0)
        self._rate = 0.0

    def connected(self) -> None:
        """A connection was made."""
        self._connections += 1
        self._window = (time.monotonic(), self.received)
        self._rate = 0.0

    def disconnected(self, session: PacketProtocol) -> None:
        """It is over; what its protocol counted stays counted."""
        framer = session.framer
        self._skipped += framer.skipped + len(framer.rest)
        self._resyncs += framer.resyncs
        self._unknown += session.unknown
        self._tails += session.tails

    def count(self, packets: int, failed: int, size: int, stamp: Stamp) -> None:
        """So many packets were decoded and so many failed, in so many bytes."""
        self._bytes += size
        self._failed += failed
        self.received += packets + failed
        arrived = stamp[0]
        since, before = self._window
        if arrived - since >= 1.0:
            self._rate = (self.received - before) / (arrived - since)
            self._window = (arrived, self.received)
        if packets:
            self._arrived = arrived

    @property
    def failed(self) -> int:
        """Packets that could not be decoded."""
        return self._failed

    def statistics(self, dropped: int, session: PacketProtocol | None) -> StreamStatistics:
        """The counters at this moment. `dropped` was read before, so that it is part of `received`."""
        now = time.monotonic()
        failed = self._failed
        received = self.received
        (since, count), rate = self._window, self._rate
        elapsed = now - since
        if elapsed > 2.0 or (not rate and elapsed > 0.5):
            rate = (received - count) / elapsed  # the last whole window is too old, or there was none
        return StreamStatistics(
            received=received,
            delivered=received - dropped - failed,
            dropped=dropped,
            failed=failed,
            reconnects=max(self._connections - 1, 0),
            rate=rate,
            bytes=self._bytes,
            skipped=self._skipped + (session.framer.skipped if session is not None else 0),
            resyncs=self._resyncs + (session.framer.resyncs if session is not None else 0),
            unknown=self._unknown + (session.unknown if session is not None else 0),
            tails=self._tails + (session.tails if session is not None else 0),
            age=None if self._arrived is None else now - self._arrived,
        )

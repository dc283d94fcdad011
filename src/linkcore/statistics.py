"""The counters of streams and subscriptions. Nothing disappears silently."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["StreamStatistics", "SubscriptionStatistics"]


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

"""The counters of streams and subscriptions. Nothing disappears silently.

Each counter is raised where its event happens, and none is computed from others, so that their sums are a check:

- of a stream: ``received == decoded + failed``
- of a subscription: ``offered == delivered + dropped + raised + waiting``

There is no lock around them. A snapshot waits a moment for a thread that is between two of its
counters; sums that do not add up after that are an error in counting.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol, TypeVar

from .. import clock
from ..wire.cycles import MissedCycles, Missing
from ..wire.framing import PacketProtocol
from .peer_clock import OffsetEstimator

#: Seconds that a call in the reader thread may last; longer ones count as `slow_inline`. A quarter of the 2 ms between
#: two packets of an e-Series controller.
SLOW_INLINE = 0.5e-3


@dataclass(frozen=True)
class StreamStatistics:
    """Counters of one stream at one moment; ``received == decoded + failed``.

    Attributes:
        received: Packets that were received.
        decoded: Packets that were decoded to typed states, and handed out.
        failed: Packets that could not be decoded.
        missed: packets that never came, by the controller's own clock: cycles between two packets of one connection
            that are too far apart. It is beside ``received``, no part of it. What a controller sent while there was no
            connection is not in it, since a controller that was started again has started its clock again; `reconnects`
            counts those. None where the packets have no such clock: RTDE without ``timestamp``, CB2's robot states.
        gaps: places where some were missed; `longest_gap` is the longest of them, s, by the controller's clock.
        duplicates: Received packets with the same controller time as the packet before. None if `missed` is.
        dropped: Packets that loops over the stream did not get, because an earlier packet kept the loop busy or because
            they were older than the lifespan. A ``for`` loop keeps only the newest state, so a slow loop drops states.
            Each loop counts on its own; subscriptions have counters of their own.
        slow_inline: calls of inline callbacks that lasted longer than 0.5 ms. Meanwhile nothing is read, and no
            other subscriber of this stream gets a packet.
        reconnects: Connections after the first.
        rate: Packets per second, over about the last second; 0 in the first half second of a connection.
        bytes: Received bytes.
        skipped: Bytes discarded during the search for a lost frame boundary.
        resyncs: Lost frame boundaries that were found again.
        unknown: Packets, or parts of a packet, whose type has no known layout.
        tails: Packets, or parts of a packet, that end in bytes which no known layout explains.
        age: Seconds since the last packet was read; None before the first one. It grows while the robot is silent, and
            while an inline callback or a full queue keeps the reader.
    """

    received: int
    decoded: int
    failed: int
    missed: int | None
    gaps: int
    longest_gap: float
    slow_inline: int
    reconnects: int
    rate: float
    bytes: int
    skipped: int
    resyncs: int
    unknown: int
    tails: int
    age: float | None
    duplicates: int | None = 0
    dropped: int = 0


@dataclass(frozen=True)
class SubscriptionStatistics:
    """Counters of one subscription; ``offered == delivered + dropped + raised + waiting``.

    Attributes:
        offered: Packets that arrived for the subscription.
        delivered: Packets whose callback returned.
        dropped: Packets discarded because the subscription fell behind or was closed, or because they had expired.
        raised: Packets whose callback raised.
        waiting: Packets in its queue, and the packet in its callback.
        missed_deadlines: Number of times that no packet arrived in time.
        expired: Packets among `dropped` that were older than the lifespan when they would have been delivered.
    """

    offered: int
    delivered: int
    dropped: int
    raised: int
    waiting: int
    missed_deadlines: int
    expired: int = 0


#: Seconds that a look at counters waits for a thread that is between two of them: four turns of Python's threads.
_MOMENT = 0.02

S = TypeVar("S", StreamStatistics, SubscriptionStatistics)


def snapshot(take: Callable[[], S]) -> S:
    """What `take` returns, as soon as its sum holds; after a moment as it is."""
    until = clock.now() + _MOMENT
    while True:
        statistics = take()
        if isinstance(statistics, StreamStatistics):
            rest = statistics.received - statistics.decoded - statistics.failed
        else:
            taken = statistics.delivered + statistics.dropped + statistics.raised + statistics.waiting
            rest = statistics.offered - taken
        if not rest or clock.now() >= until:
            return statistics
        clock.sleep(_MOMENT / 100)


class Loop(Protocol):
    """The queue of a loop over a stream."""

    @property
    def overtaken(self) -> int:
        """Packets that were dropped because newer ones replaced them, or because they had expired."""


class StreamCounters:
    """What the reader counts. Only the reader writes it, so it needs no lock; queues of loops have one.

    Attributes:
        received, decoded, failed, slow_inline, bytes, connections: see `StreamStatistics`.
        arrived: when the last packet was read, by `linkcore.clock.now`; None before the first.
        clock_offset: between the peer's clock and this computer's, by the times of its packets.
        window_ends: when `next_window` is due: the rate is that of the last whole window of about a second.
        due: when `look` is due, by `linkcore.clock.now`.
    """

    def __init__(self) -> None:
        self.received = 0
        self.decoded = 0
        self.failed = 0
        self.slow_inline = 0
        self.bytes = 0
        self.connections = 0
        # Of the connections that are over; what the present one has counted stands in its protocol.
        self._skipped = self._resyncs = self._unknown = self._tails = 0
        self._missing: Missing | None = None
        self._duplicates = 0
        # The queues of loops that run, and what those of the ended loops dropped. Re-entrant: a loop may be collected
        # in the middle of a change.
        self._loops: tuple[Loop, ...] = ()
        self._dropped = 0
        self._changing_loops = threading.RLock()
        self._protocol: PacketProtocol | None = None
        self.arrived: float | None = None
        self._rate = 0.0
        self.clock_offset = OffsetEstimator()
        self.due = 0.0
        self._begin_window(clock.now())

    def connected(self, protocol: PacketProtocol, round_trip: float) -> None:
        """A connection was made, by a handshake of so many seconds; what its protocol counts belongs to the stream."""
        self._protocol = protocol
        self.connections += 1
        self._begin_window(clock.now())
        self._rate = 0.0
        self.clock_offset.connected(round_trip)
        self.due = 0.0

    def disconnected(self) -> None:
        """The connection is over; what its protocol counted stays counted."""
        protocol, self._protocol = self._protocol, None
        if protocol is not None:
            self._skipped += protocol.framer.skipped + len(protocol.framer.rest)
            self._resyncs += protocol.framer.resyncs
            self._unknown += protocol.unknown
            self._tails += protocol.tails
            self._missing = _sum(self._missing, protocol)
            self._duplicates += _duplicates(protocol)

    def loop_began(self, queue: Loop) -> None:
        """A loop takes packets from a queue: what the queue drops is counted for the stream."""
        with self._changing_loops:
            self._loops = (*self._loops, queue)

    def loop_ended(self, queue: Loop) -> None:
        """The loop has ended; what its queue has dropped stays counted. Idempotent."""
        with self._changing_loops:
            if queue in self._loops:
                self._loops = tuple(each for each in self._loops if each is not queue)
                self._dropped += queue.overtaken

    def look(self, now: float, cycles: MissedCycles | None) -> None:
        """Do what is not done for each packet, beside the newest one."""
        offset = self.clock_offset
        if cycles is not None and now >= offset.due:
            offset.take(cycles.last, now)
        if now >= self.window_ends:
            self.next_window(now)
        self.due = self.window_ends if cycles is None else min(self.window_ends, offset.due)

    def next_window(self, now: float) -> None:
        """The window of the rate is over; the next one begins."""
        self._rate = (self.received - self._window_received) / (now - self._window_began)
        self._begin_window(now)

    def _begin_window(self, now: float) -> None:
        self._window_began = now
        self._window_received = self.received
        self.window_ends = now + 1.0

    @property
    def statistics(self) -> StreamStatistics:
        """The counters at this moment."""
        return snapshot(self._look)

    def _look(self) -> StreamStatistics:
        # The reader goes on meanwhile. Times before the present, and what past connections have counted before what the
        # present one has: an age is never negative, and nothing counts twice.
        arrived, now = self.arrived, clock.now()
        skipped, resyncs, unknown, tails = self._skipped, self._resyncs, self._unknown, self._tails
        missing, duplicates = self._missing, self._duplicates
        with self._changing_loops:
            dropped = self._dropped + sum(queue.overtaken for queue in self._loops)
        protocol, rate, elapsed = self._protocol, self._rate, now - self._window_began
        missing = _sum(missing, protocol)
        if elapsed > 2.0 or (not rate and elapsed > 0.5):
            # The last whole window is too old, or there was none.
            rate = (self.received - self._window_received) / elapsed
        return StreamStatistics(
            received=self.received,
            decoded=self.decoded,
            failed=self.failed,
            missed=None if missing is None else missing.cycles,
            gaps=0 if missing is None else missing.gaps,
            longest_gap=0.0 if missing is None else missing.longest,
            slow_inline=self.slow_inline,
            reconnects=max(self.connections - 1, 0),
            rate=rate,
            bytes=self.bytes,
            skipped=skipped + (protocol.framer.skipped if protocol is not None else 0),
            resyncs=resyncs + (protocol.framer.resyncs if protocol is not None else 0),
            unknown=unknown + (protocol.unknown if protocol is not None else 0),
            tails=tails + (protocol.tails if protocol is not None else 0),
            age=None if arrived is None else now - arrived,
            duplicates=None if missing is None else duplicates + _duplicates(protocol),
            dropped=dropped,
        )


def _duplicates(protocol: PacketProtocol | None) -> int:
    return 0 if protocol is None or protocol.cycles is None else protocol.cycles.duplicates


def _sum(missing: Missing | None, protocol: PacketProtocol | None) -> Missing | None:
    """What is missing of the connections that are over, and of the present one."""
    if protocol is None or protocol.cycles is None:
        return missing
    return protocol.cycles.missing.plus(missing or Missing())

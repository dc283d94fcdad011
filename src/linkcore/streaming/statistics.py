"""Counters of streams and subscriptions, so that no packet disappears silently.

Each counter is incremented where its event happens, and no counter is computed from other counters. So the following
sums are a check:

- of a stream: ``received == decoded + failed``
- of a subscription: ``offered == delivered + dropped + raised + waiting``

The counters have no lock. A snapshot waits briefly for a thread that has incremented one counter and not yet the other.
If a sum still does not match after that, the counting has a defect.
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

#: Maximum duration of a call in the reader thread, in s; longer calls count as `slow_inline`. It is a quarter of the
#: 2 ms between two packets of an e-Series controller.
SLOW_INLINE = 0.5e-3


@dataclass(frozen=True)
class StreamStatistics:
    """Counters of one stream at one moment; ``received == decoded + failed``.

    Attributes:
        received: Packets that were received.
        decoded: Packets that were decoded to typed states, and handed out.
        failed: Packets that could not be decoded.
        missed: Packets that never arrived, based on the controller's clock: the missing cycles between consecutive
            packets of one connection. They are not part of ``received``. Packets that a controller sent without a
            connection are not included, because a restarted controller has also restarted its clock; `reconnects`
            counts the reconnections. None if the packets have no such clock: RTDE without ``timestamp``, and the robot
            states of CB2.
        gaps: Number of gaps with missed packets.
        longest_gap: Duration of the longest gap in s, by the controller's clock.
        duplicates: Received packets with the same controller time as the previous packet. None if `missed` is None.
        dropped: Packets that loops over the stream did not get, because an earlier packet kept the loop busy or because
            they were older than the lifespan. A ``for`` loop keeps only the newest state, so a slow loop drops states.
            Each loop counts separately. Subscriptions have separate counters.
        slow_inline: Calls of inline callbacks that lasted longer than 0.5 ms. During such a call nothing is read, and
            no other subscriber of this stream gets a packet.
        reconnects: Connections after the first.
        rate: Packets per second, over about the last second; 0 in the first half second of a connection.
        bytes: Received bytes.
        skipped: Bytes discarded during the search for a lost frame boundary.
        resyncs: Lost frame boundaries that were found again.
        unknown: Packets, or parts of a packet, whose type has no known layout.
        tails: Packets, or parts of a packet, that end in bytes which no known layout describes.
        age: Seconds since the last packet was read; None before the first one. It grows while the robot is silent, and
            while an inline callback or a full queue blocks the reader.
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


#: Maximum time in s that a snapshot waits for a thread that is between two counters: four switches of Python's threads.
_MOMENT = 0.02

S = TypeVar("S", StreamStatistics, SubscriptionStatistics)


def snapshot(take: Callable[[], S]) -> S:
    """Return the counters from `take` when their sum matches, or after 0.02 s in any case."""
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
    """Queue of a loop over a stream."""

    @property
    def overtaken(self) -> int:
        """Number of packets that were replaced by newer ones, or had expired."""


class StreamCounters:
    """Counters of the reader.

    Only the reader changes them, so they need no lock; the queues of loops have a lock.

    Attributes:
        received, decoded, failed, slow_inline, bytes: See `StreamStatistics`.
        connections: Number of connections.
        arrived: Time of `linkcore.clock.now` at which the last packet was read; None before the first packet.
        clock_offset: Estimator of the offset between the clocks of the peer and of this computer.
        window_ends: Time at which `next_window` is due. The rate is measured over the last complete window of about a
            second.
        due: Time of `linkcore.clock.now` at which `look` is due.
    """

    def __init__(self) -> None:
        self.received = 0
        self.decoded = 0
        self.failed = 0
        self.slow_inline = 0
        self.bytes = 0
        self.connections = 0
        # Counters of ended connections. The protocol of the current connection has its own counters.
        self._skipped = self._resyncs = self._unknown = self._tails = 0
        self._missing: Missing | None = None
        self._duplicates = 0
        # Queues of running loops, and the number of packets dropped by ended loops. The lock is re-entrant, because a
        # loop might be garbage-collected in the middle of a change.
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
        """Record a new connection; the counters of its protocol are added to the stream.

        Args:
            protocol: Protocol of the connection.
            round_trip: Duration of its handshake in s; `inf` if there was no handshake.
        """
        self._protocol = protocol
        self.connections += 1
        self._begin_window(clock.now())
        self._rate = 0.0
        self.clock_offset.connected(round_trip)
        self.due = 0.0

    def disconnected(self) -> None:
        """Record that the connection has ended, and keep the counts of its protocol."""
        protocol, self._protocol = self._protocol, None
        if protocol is not None:
            self._skipped += protocol.framer.skipped + len(protocol.framer.rest)
            self._resyncs += protocol.framer.resyncs
            self._unknown += protocol.unknown
            self._tails += protocol.tails
            self._missing = _sum(self._missing, protocol)
            self._duplicates += _duplicates(protocol)

    def loop_began(self, queue: Loop) -> None:
        """Record that a loop takes packets from a queue, to count its dropped packets for the stream."""
        with self._changing_loops:
            self._loops = (*self._loops, queue)

    def loop_ended(self, queue: Loop) -> None:
        """Record that a loop has ended, and keep the count of its dropped packets. Idempotent."""
        with self._changing_loops:
            if queue in self._loops:
                self._loops = tuple(each for each in self._loops if each is not queue)
                self._dropped += queue.overtaken

    def look(self, now: float, cycles: MissedCycles | None) -> None:
        """Update the clock offset and the rate if they are due, which is not necessary for each packet."""
        offset = self.clock_offset
        if cycles is not None and now >= offset.due:
            offset.take(cycles.last, now)
        if now >= self.window_ends:
            self.next_window(now)
        self.due = self.window_ends if cycles is None else min(self.window_ends, offset.due)

    def next_window(self, now: float) -> None:
        """Compute the rate of the window that has ended, and start the next window."""
        began, received = self._window
        self._rate = (self.received - received) / (now - began)
        self._begin_window(now)

    def _begin_window(self, now: float) -> None:
        self._window = now, self.received  # replaced as a whole, because other threads read it
        self.window_ends = now + 1.0

    @property
    def statistics(self) -> StreamStatistics:
        """Counters at this moment."""
        return snapshot(self._look)

    def _look(self) -> StreamStatistics:
        # The reader continues meanwhile. The arrival time is read before the current time, so that an age is never
        # negative. The counts of past connections are read before the current ones, so that nothing counts twice.
        arrived, now = self.arrived, clock.now()
        skipped, resyncs, unknown, tails = self._skipped, self._resyncs, self._unknown, self._tails
        missing, duplicates = self._missing, self._duplicates
        with self._changing_loops:
            dropped = self._dropped + sum(queue.overtaken for queue in self._loops)
        began, before = self._window
        protocol, rate, elapsed = self._protocol, self._rate, now - began
        missing = _sum(missing, protocol)
        if elapsed > 2.0 or (not rate and elapsed > 0.5):
            # The last complete window is too old, or does not exist.
            rate = (self.received - before) / elapsed
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
    """Return the missing packets of the ended connections and of the current one."""
    if protocol is None or protocol.cycles is None:
        return missing
    return protocol.cycles.missing.plus(missing or Missing())

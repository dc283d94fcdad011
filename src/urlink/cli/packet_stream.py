"""`Tap`, which receives every packet of a stream for a command, and the counters of a stream as text."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any

from linkcore import clock
from linkcore.errors import LinkTimeout
from linkcore.streaming.connection_life import ConnectionEvent, ConnectionState
from linkcore.streaming.packet_queue import drop_oldest
from linkcore.streaming.statistics import StreamStatistics
from linkcore.streaming.stream import Stream
from linkcore.wire.cycles import Missing

from .options import tell

#: Maximum number of queued packets, enough for half a minute of the fastest interface.
_ROOM = 16384


class Tap:
    """Receiver of all packets of class `kind` on a stream; a context manager.

    Raises:
        RemoteError: If the stream could not be opened.
    """

    def __init__(self, stream: Stream[Any], kind: type) -> None:
        self._stream = stream
        self._kind = kind
        # A packet that is not read in time is dropped, so the queue is long. The playback of a recording waits instead.
        self._queue = stream._connection.open_queue(kind, stream._policy(None, drop_oldest(_ROOM)))
        self._connection = stream.subscribe(_tell_connection, ConnectionEvent)

    def take(self, timeout: float | None = None) -> Sequence[Any] | None:
        """Return the next packets: empty if none arrives within `timeout` seconds, None if the stream has ended.

        Raises:
            RemoteError: If the stream gave up reconnecting.
        """
        packet = self._queue.next(timeout)
        if packet is not None:
            return list(self._stream._connection.fan_out.expand(self._kind, packet))
        if self._queue.is_over:
            if self._stream.failure is not None:
                raise self._stream.failure
            return None
        return ()

    def packets(self, silence: float | None = None, duration: float | None = None) -> Iterator[Any]:
        """Yield each packet, until the stream ends, or `duration` seconds have passed.

        Raises:
            LinkTimeout: If no packet arrives for `silence` seconds.
            RemoteError: If the stream gave up reconnecting.
        """
        until = math.inf if duration is None else clock.now() + duration
        while (left := until - clock.now()) > 0.0:
            is_last = left < (math.inf if silence is None else silence)
            packets = self.take(left if is_last else silence)
            if packets is None:
                return
            yield from packets
            if not packets and not is_last:
                raise LinkTimeout(f"no {self._kind.__name__} from {self._stream.name} within {silence:g} s")

    def __enter__(self) -> Tap:
        return self

    def __exit__(self, *exc: object) -> None:
        self._connection.close()  # first, so that closing is not printed as a lost connection
        # Packets that are still queued at the end do not count as dropped.
        dropped = self._queue.dropped
        self._stream._connection.close_queue(self._queue)
        stats = self._stream.stats
        if dropped:
            tell(f"{dropped} packets were dropped, because the output was too slow")
        if stats.failed:
            tell(f"{stats.failed} packets could not be decoded")
        if stats.missed:
            missing = Missing(stats.missed, stats.gaps, stats.longest_gap)
            tell(
                f"{missing.text(stats.received)} according to the controller's clock; the controller did not send them"
            )
        if stats.duplicates:
            tell(f"{stats.duplicates} packets arrived twice, by the controller's clock")
        if stats.skipped:
            tell(f"{stats.skipped} bytes belonged to no packet")


def _tell_connection(event: ConnectionEvent) -> None:
    if event.state is ConnectionState.LOST:
        tell(f"{event.stream}: connection lost: {event.error}; reconnecting")


def counted(stats: StreamStatistics) -> str:
    """Format the counters of a stream.

    If the packets contain no clock, missed packets and duplicates are unknown, and are shown as "-".
    """
    missed, duplicates = ("-" if each is None else each for each in (stats.missed, stats.duplicates))
    return (
        f"received {stats.received} missed {missed} duplicates {duplicates} failed {stats.failed} "
        f"reconnects {stats.reconnects}"
    )

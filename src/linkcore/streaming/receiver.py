"""Conversion of bytes to packets, with counters. This part of a stream uses neither a thread nor a socket (sans-IO).

The reader thread passes the received bytes to it, and publishes the returned packets. An asyncio protocol could do the
same in `data_received`.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from typing import Any

from ..clock import Stamp
from ..deferred import Deferred, DeferredBatch, SteadyBytes
from ..errors import PacketError
from ..text import printable
from ..wire.deferred_packet import DeferredPacket
from ..wire.framing import PacketProtocol, is_strict, strictly
from .flight_record import FlightRecord
from .statistics import StreamCounters

_log = logging.getLogger(__name__)

#: NaN, because every comparison with NaN is false.
_NO_TIME = float("nan")


class Receiver:
    """Receiving side of one connection.

    Args:
        name: Name of the stream, used in the log.
        protocol: Protocol of this connection.
        counters: Counters of the stream. They outlive the connection.
        flight: Record of the received bytes; None to keep no record.
    """

    def __init__(
        self, name: str, protocol: PacketProtocol, counters: StreamCounters, flight: FlightRecord | None = None
    ) -> None:
        self._flight = flight
        self._keep = None if flight is None else flight.keep
        self._name = name
        self._protocol = protocol
        self._feed = protocol.framer.feed
        self._counters = counters
        self._strictly = strictly(protocol) if is_strict() else None

    @property
    def rest(self) -> bytes:
        """Bytes of a packet that is not complete yet."""
        return self._protocol.framer.rest

    def feed(self, data: bytes, stamp: Stamp) -> Sequence[Any]:
        """Return the typed packets that `data` completes.

        An invalid packet does not affect the others.

        Raises:
            WrongPeer: If the bytes do not belong to such a stream.
        """
        counters = self._counters
        counters.bytes += len(data)
        frames = self._feed(data)
        if not frames:
            self._keep_batch(data, stamp)
            return ()
        count = len(frames)
        counters.received += count
        protocol = self._protocol
        cycles = protocol.cycles
        if count != 1:
            self._keep_batch(data, stamp)
            packets = self._many(frames, stamp)
        else:
            # Nearly always one packet has arrived, and it follows the last one. This case is detected without a call of
            # Python code, because a branch separate from `_many` takes about 850 instructions fewer.
            (frame,) = frames
            keep = self._keep
            if keep is not None:
                keep(data)
                keep(stamp[0])
            if cycles is not None:
                moment = cycles.time(frame)[0] if len(frame) == cycles.size else _NO_TIME
                if 0.0 < moment - cycles.last <= cycles.at_most:
                    cycles.last = moment
                else:
                    cycles.take(frames)
            try:
                packets = [(self._strictly or protocol.decode)(frame, stamp)]
                counters.decoded += 1
            except PacketError as error:
                self._fail(error)
                packets = []
        now = counters.arrived = stamp[0]
        if now >= counters.due:
            counters.look(now, cycles)
        return packets

    def feed_steady(self, data: Any, stamp: Stamp) -> Sequence[Any]:
        """Do the same for steady packets of a simulated peer; see `DeferredReceiver`."""
        return self.feed(data, stamp)

    def _keep_batch(self, data: bytes, stamp: Stamp) -> None:
        """Record a chunk that is not one packet."""
        flight = self._flight
        if flight is not None:
            flight.keep(data)
            flight.keep(stamp[0])
            flight.batch(len(data))

    def _many(self, frames: Sequence[bytes], stamp: Stamp) -> list[Any]:
        protocol, packets = self._protocol, []
        if protocol.cycles is not None:
            protocol.cycles.take(frames)
        # Looked up each time, because the protocol might have replaced its decoder after these frames.
        decode = self._strictly or protocol.decode
        for frame in frames:
            try:
                packets.append(decode(frame, stamp))
            except PacketError as error:
                self._fail(error)
        self._counters.decoded += len(packets)
        return packets

    def _fail(self, error: PacketError) -> None:
        self._counters.failed += 1
        failed = self._counters.failed
        if failed & (failed - 1) == 0:  # log at each power of two, because bad packets at 500 Hz must not fill the disk
            _log.warning("%s: bad packet, %d so far: %s", self._name, failed, printable(error))


class SteadyPackets(Sequence[Any]):
    """States of a `DeferredBatch`, in order. Each state is made when it is accessed.

    Args:
        batch: Packets.
        stamp: Arrival of the last packet.
    """

    def __init__(self, batch: DeferredBatch[DeferredPacket], stamp: Stamp) -> None:
        self._batch = batch
        self._stamp = stamp
        self._last: Any = None

    def __len__(self) -> int:
        return len(self._batch.packets)

    def __getitem__(self, at: Any) -> Any:
        if isinstance(at, slice):
            return [self[each] for each in range(len(self))[at]]
        if at == -1:
            if self._last is None:
                self._last = self._batch.last.state(self._stamp)
            return self._last
        age, (monotonic, wall) = self._batch.ages[at], self._stamp
        return self._batch.packets[at].state(Stamp(monotonic - age, wall - age))


class DeferredReceiver(Receiver):
    """Receiver for a simulated connection, which delivers bytes, and packets whose bytes are not made yet.

    It counts the same as `Receiver` does for the bytes of the packets.

    Attributes:
        leaves_unread: Whether `feed_steady` makes a packet only if somebody asks for it, so that no subscriber may need
            it.
    """

    def __init__(self, *args: Any) -> None:
        super().__init__(*args)
        take, steady = (
            None if self._strictly is not None else getattr(self._protocol, name, None)
            for name in ("take_deferred", "take_steady")
        )
        self._take: Callable[[DeferredPacket, Stamp], Any] | None = take
        self._take_steady: Callable[[Deferred, Stamp], Any] | None = steady
        self.leaves_unread = steady is not None

    def is_next(self, data: Deferred | SteadyBytes) -> bool:
        """Whether a packet directly follows the last one of this connection. Otherwise it might not be steady."""
        if isinstance(data.first if isinstance(data, DeferredBatch) else data, SteadyBytes):
            return not self.rest  # its predecessor is the previous packet of this connection
        cycles = self._protocol.cycles
        return cycles is not None and cycles.is_next(cycles.moment_of(data.head))

    def feed(self, data: bytes | Deferred, stamp: Stamp) -> Sequence[Any]:
        """See `Receiver.feed`."""
        first = data.first if isinstance(data, DeferredBatch) else data
        if self._take is None or not isinstance(first, DeferredPacket):
            return super().feed(bytes(data), stamp)
        state = self._take(first, stamp)
        if state is None:
            return super().feed(bytes(data), stamp)
        states = SteadyPackets(data, stamp) if isinstance(data, DeferredBatch) else (state,)
        return self._taken(data, first, states, stamp)

    def feed_steady(self, data: Deferred | SteadyBytes, stamp: Stamp) -> Sequence[Any]:
        """Do the same for steady packets of which no subscriber needs more than the time of the last one."""
        take = self._take_steady
        if take is None or isinstance(data, SteadyBytes):
            return self.feed(data, stamp)
        packets, ages = (data.packets, data.ages) if isinstance(data, DeferredBatch) else ((data,), (0.0,))
        states = []
        for packet, age in zip(packets, ages, strict=True):
            state = take(packet, Stamp(stamp.monotonic - age, stamp.wall - age) if age else stamp)
            if state is None:
                return self.feed(data, stamp)
            states.append(state)
        return self._taken(data, packets[0], states, stamp)

    def _taken(self, data: Any, first: Any, states: Sequence[Any], stamp: Stamp) -> Sequence[Any]:
        """Count packets whose bytes were not made; return their states."""
        count = len(states)
        counters, cycles, keep = self._counters, self._protocol.cycles, self._keep
        counters.bytes += len(data)
        counters.received += count
        if keep is not None:
            keep(data)
            keep(stamp[0])
        if cycles is not None:
            cycles.take_moment(cycles.moment_of(first.head))
            if count > 1:
                cycles.last = cycles.moment_of(data.last.head)
        counters.decoded += count
        now = counters.arrived = stamp[0]
        if now >= counters.due:
            counters.look(now, cycles)
        return states

"""Packets of a recorded connection, found without a Python object for each packet.

A controller sends packets of one size, and most of them are recorded one by one. A record consists of packets of the
same layout if its length is that of one or several packets like the previous packet, and if each of them begins with
the same header. Then only the offsets of these packets in the file are kept. All other bytes are passed to the framer
and the decoder of a stream. So the result does not depend on the division into records; a property test checks this.
"""

from __future__ import annotations

import itertools
import operator
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..clock import Stamp
from ..errors import PacketError, WrongPeer
from ..wire.framing import PacketProtocol
from ..wire.layout import Layout
from ..wire.packet import State
from .file import Kind, Progress, described
from .index import Numbers, RecordIndex


class Part:
    """Packets of one layout, represented by the offsets of their bytes.

    Attributes:
        layout: Layout of all packets.
        place: Offset of each packet in the file, shape (n,). A negative place is the offset ``~place`` in `extra`.
        record: Number of the record that completed each packet, shape (n,).
    """

    def __init__(
        self, layout: Layout, data: NDArray[np.uint8], extra: NDArray[np.uint8], place: Numbers, record: Numbers
    ) -> None:
        self.layout = layout
        self.place = place
        self.record = record
        self._data = data
        self._extra = extra
        steps = np.diff(place)
        #: Distance in bytes between packets if it is the same for all packets, so that they need not be copied
        #: together; otherwise 0.
        self._stride = int(steps[0]) if len(steps) and place[0] >= 0 and (steps == steps[0]).all() else 0

    def __len__(self) -> int:
        return len(self.place)

    def view(self, begin: int, end: int, offset: int, dtype: np.dtype[Any]) -> NDArray[Any]:
        """Return the bytes at `offset` of each of the packets `begin` to `end`, as `dtype`, shape (end - begin,)."""
        count = end - begin
        if self._stride and count:
            return np.ndarray((count,), dtype, self._data, int(self.place[begin]) + offset, (self._stride,))
        place = self.place[begin:end]
        found = np.empty(count, np.dtype((np.void, dtype.itemsize)))
        in_file = place >= 0
        for source, chosen, places in (
            (self._data, in_file, place[in_file]),
            (self._extra, ~in_file, ~place[~in_file]),
        ):
            if len(places):
                every = np.ndarray((int(places.max()) + 1,), found.dtype, source, offset, (1,))
                found[chosen] = every[places]
        return found.view(dtype)

    def sliced(self, begin: int, end: int) -> Part:
        """Return the packets `begin` to `end`."""
        return Part(self.layout, self._data, self._extra, self.place[begin:end], self.record[begin:end])


class Channel(NamedTuple):
    """Recorded packets of one stream.

    Attributes:
        parts: Packets of the main class, in order. A new part begins when the layout changes.
        others: All other decoded packets, each with the number of its record.
        begins: Number of the first record of each connection, except of the first connection.
        skipped: Number of bytes that belong to no packet.
        failed: Error of each packet that could not be decoded.
    """

    parts: list[Part]
    others: list[tuple[int, State]]
    begins: list[int]
    skipped: int
    failed: list[str]


def read_channel(
    index: RecordIndex,
    number: int,
    protocol: Callable[[], PacketProtocol],
    kind: type[State],
    *,
    is_uniform: bool,
    progress: Progress,
) -> Channel:
    """Read the packets of a channel.

    Args:
        index: Index of the recording.
        number: Number of the channel.
        protocol: Function that returns a new protocol for each connection.
        kind: Class of the packets that become rows.
        is_uniform: Whether packets of this class with the same header and size have the same layout.
        progress: Function that is called with the completed fraction, 0 to 1.
    """
    reader = _Reader(index, kind, is_uniform, progress)
    begins: list[int] = []
    for records in _connections(index, number):
        if reader.has_read:
            begins.append(int(records[0]))
        reader.read(records, protocol())
    return Channel(reader.parts(), reader.others, begins, reader.skipped, reader.failed)


def states_of(states: Sequence[tuple[int, State]]) -> list[Part]:
    """Group decoded packets, each with the number of its record, by layout."""
    places = _Places()
    for record, state in states:
        places.add(state._layout, places.keep(bytes(state)), record)
    return places.parts(np.empty(0, np.uint8))


def _connections(index: RecordIndex, number: int) -> Iterator[Numbers]:
    """Yield the records with the bytes of each connection; damage ends a connection too."""
    mine = index.of(number)
    kinds = index.kind[mine]
    events = mine[kinds == Kind.EVENT].tolist()
    ends = [at for at in events if described(index.path, number, index.payload(at), "state")["state"] == "lost"]
    ends += [gap.record for gap in index.gaps]
    records = mine[kinds == Kind.BYTES]
    for piece in np.split(records, np.searchsorted(records, sorted(ends))):
        if len(piece):
            yield piece


class _Places:
    """Collector of the offsets of packets, run by run."""

    def __init__(self) -> None:
        self._runs: list[tuple[Layout, Numbers, Numbers]] = []
        self._single: tuple[Layout, list[int], list[int]] | None = None
        self._extra = bytearray()

    def keep(self, data: bytes) -> int:
        """Keep the bytes of a packet that is not contiguous in the file; return its place."""
        place = ~len(self._extra)
        self._extra += data
        return place

    def add(self, layout: Layout, place: int, record: int) -> None:
        """Add one packet."""
        if self._single is None or self._single[0] is not layout:
            self._finish()
            self._single = (layout, [], [])
        _, places, records = self._single
        places.append(place)
        records.append(record)

    def extend(self, layout: Layout, place: Numbers, record: Numbers) -> None:
        """Add packets by their offsets in the file."""
        self._finish()
        self._runs.append((layout, place, record))

    def _finish(self) -> None:
        if self._single is not None:
            layout, place, record = self._single
            self._runs.append((layout, np.array(place, np.int64), np.array(record, np.int64)))
            self._single = None

    def parts(self, data: NDArray[np.uint8]) -> list[Part]:
        self._finish()
        extra = np.frombuffer(bytes(self._extra), np.uint8)
        parts = []
        for layout, group in itertools.groupby(self._runs, key=operator.itemgetter(0)):
            runs = list(group)
            place = np.concatenate([run[1] for run in runs])
            record = np.concatenate([run[2] for run in runs])
            parts.append(Part(layout, data, extra, place, record))
        return parts


class _Reader:
    """Reader of one channel, connection by connection."""

    def __init__(self, index: RecordIndex, kind: type[State], is_uniform: bool, progress: Progress) -> None:
        self.others: list[tuple[int, State]] = []
        self.skipped = 0
        self.failed: list[str] = []
        self.has_read = False
        self._index = index
        self._kind = kind
        self._is_uniform = is_uniform
        self._progress = progress
        self._places = _Places()

    def parts(self) -> list[Part]:
        return self._places.parts(self._index.data)

    def read(self, records: Numbers, protocol: PacketProtocol) -> None:
        """Read the packets of one connection."""
        self.has_read = True
        framer = protocol.framer
        last: State | None = None  # the last packet of the main class
        # The header with which records were compared, and the records that differ from it.
        header, odd = b"", np.empty(0, np.int64)
        at = 0
        try:
            while at < len(records):
                if last is not None and framer.is_between_packets:
                    width = last._layout.header.width
                    if (begin := bytes(last)[:width]) != header:
                        header = begin
                        odd = at + np.flatnonzero(~self._are_packets(records[at:], header, len(bytes(last))))
                    until = int(odd[place]) if (place := int(np.searchsorted(odd, at))) < len(odd) else len(records)
                    if until > at:
                        before = self._take(records[at:until], last)
                        if until < len(records):
                            # The framer continues after the last packet, as if it had cut all of them.
                            framer.feed(before)
                        at = until
                        continue
                last = self._decode(int(records[at]), protocol, last)
                self._progress(int(records[at]) / len(self._index.kind))
                at += 1
        except WrongPeer as error:
            self.failed.append(str(error))
        self.skipped += framer.skipped + len(framer.rest)

    def _are_packets(self, records: Numbers, header: bytes, size: int) -> NDArray[np.bool_]:
        """Return whether each record consists of packets with this size and header."""
        sizes = self._index.size[records]
        good: NDArray[np.bool_] = (sizes % size == 0) & (sizes > 0)
        places, owners = self._packets(records[good], size)
        # The headers are compared as text of a fixed width, because numpy can do this for all packets at once.
        width = len(header)
        every = np.ndarray((len(self._index.data) - width + 1,), f"S{width}", self._index.data, 0, (1,))
        good[np.searchsorted(records, owners[every[places] != header])] = False
        return good

    def _packets(self, records: Numbers, size: int) -> tuple[Numbers, Numbers]:
        """Return the offset and the record of each packet, for records that consist of packets."""
        offsets, counts = self._index.offset[records], self._index.size[records] // size
        if (counts == 1).all():
            return offsets, records
        within = np.arange(int(counts.sum())) - np.repeat(np.cumsum(counts) - counts, counts)
        return np.repeat(offsets, counts) + size * within, np.repeat(records, counts)

    def _take(self, records: Numbers, like: State) -> bytes:
        """Keep the offsets of the packets in these records; return the bytes of the last packet."""
        size = len(bytes(like))
        places, owners = self._packets(records, size)
        self._places.extend(like._layout, places, owners)
        last = int(places[-1])
        return self._index.data[last : last + size].tobytes()

    def _decode(self, record: int, protocol: PacketProtocol, last: State | None) -> State | None:
        """Decode the packets that a record completes.

        Return the packet with which the next records can be compared, or None.
        """
        index = self._index
        stamp = Stamp(index.monotonic[record].item() / 1e9, index.wall[record].item() / 1e9)
        payload = index.payload(record)
        for frame in protocol.framer.feed(payload):
            try:
                state = protocol.decode(frame, stamp)
            except PacketError as error:
                self.failed.append(str(error))
                continue
            if isinstance(state, self._kind) and self._is_uniform:
                place = int(index.offset[record]) if frame == payload else self._places.keep(frame)
                self._places.add(state._layout, place, record)
                last = state
            else:
                # It might be a version message, which determines how the next packets are decoded.
                self.others.append((record, state))
                last = None
        return last

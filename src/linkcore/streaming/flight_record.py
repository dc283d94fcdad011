"""Flight record: the bytes that were received from a robot and sent to it in the last seconds, in bounded memory.

The record of received bytes contains references to the received bytes, not decoded packets. So the reader needs only a
few hundred instructions for each packet. The bytes are decoded when an explanation is requested, which is rare.
"""

from __future__ import annotations

import math
import threading
from bisect import bisect_left
from collections import deque
from collections.abc import Sequence
from typing import Any, NamedTuple

from .. import clock
from ..deferred import Deferred, DeferredBatch

#: Time that a record covers, in s.
SECONDS = 10.0
#: Memory that Python needs for a chunk in addition to its bytes: two objects and two references, in bytes.
OVERHEAD = 96
#: Bytes of batches after which the size of a record is checked.
_CHECKED_AFTER = 1 << 20
#: Number of attempts to copy a record while the reader changes it.
_TRIES = 100
#: Number of sent messages after which their record is trimmed.
_STEP = 64


class Received(NamedTuple):
    """Bytes of one call of `recv`; empty at the beginning of a connection.

    Attributes:
        time: Arrival, in s of `linkcore.clock.now`.
        data: Received bytes.
    """

    time: float
    data: bytes


class FlightRecord:
    """Bytes that one connection has received recently. Only the reader changes the record.

    In normal operation, one call of `recv` returns one packet. The record then needs no check of its size, because it
    has a maximum number of chunks, and packets have a maximum size. Other chunks are counted by `batch`.

    Args:
        most: Maximum number of chunks.
        size: Maximum memory in bytes. If batches of packets exceed it, the oldest chunks are removed.

    Attributes:
        keep: Function that appends a chunk, and then its arrival time. Bytes and floats are appended alternately,
            because the garbage collector of Python does not track them, unlike tuples.
    """

    def __init__(self, most: int, size: int) -> None:
        self._entries: deque[bytes | Deferred | float] = deque(maxlen=2 * most)
        self.keep = self._entries.append
        self._size = size
        self._batched = 0

    def batch(self, count: int) -> None:
        """Count the bytes of a chunk that is not one packet. If there are too many, remove the oldest chunks."""
        self._batched += count
        if self._batched < _CHECKED_AFTER:
            return
        self._batched = 0
        chunks = self.chunks
        excess = sum(len(each.data) + OVERHEAD for each in chunks) - self._size
        for each in chunks:
            if excess <= 0:
                break
            excess -= len(each.data) + OVERHEAD
            self._entries.popleft()
            self._entries.popleft()

    @property
    def chunks(self) -> Sequence[Received]:
        """Copy of the record, with the oldest chunk first. Any thread may read it."""
        return [Received(time, data) for data, time in zip(*self.since(-math.inf), strict=False)]

    def since(self, begin: float) -> tuple[list[bytes], list[float]]:
        """Return the chunks that arrived at `begin` or later, and their times. Any thread may call this."""
        entries: list[bytes | Deferred | float] = []
        for _ in range(_TRIES):
            try:
                entries = list(self._entries)
                break
            except RuntimeError:  # the reader has changed it meanwhile
                continue
        if entries and isinstance(entries[0], float):  # copied while the oldest chunk was being replaced
            del entries[0]
        data, times = _in_bytes(entries[::2], entries[1::2])
        first = bisect_left(times, begin)
        return data[first:], times[first:]


def _in_bytes(chunks: Sequence[Any], times: Sequence[Any]) -> tuple[list[bytes], list[float]]:
    """Return the same chunks as bytes. The packets of a `DeferredBatch` become one chunk each."""
    if all(isinstance(chunk, bytes) for chunk in chunks):
        return list(chunks), list(times)
    parts = [
        (bytes(packet), time - age)
        for chunk, time in zip(chunks, times, strict=False)
        for packet, age in (
            zip(chunk.packets, chunk.ages, strict=True) if isinstance(chunk, DeferredBatch) else ((chunk, 0.0),)
        )
    ]
    return [data for data, _ in parts], [time for _, time in parts]


class Sent(NamedTuple):
    """Bytes that were passed to the kernel.

    Attributes:
        time: Time of the call, in s of `linkcore.clock.now`.
        channel: Receiver of the bytes, such as "primary".
        data: First bytes of the message, at most `LONGEST`.
    """

    time: float
    channel: str
    data: bytes


def _memory(sent: Sent) -> int:
    """Return the memory of one message in a record, in bytes."""
    return len(sent.data) + 2 * OVERHEAD


#: Maximum number of bytes that are kept of one sent message.
LONGEST = 2048


class SentRecord:
    """Bytes that were sent to one robot in the last `SECONDS`. Any thread may add to it.

    Args:
        most: Maximum memory of the record, in bytes.
    """

    def __init__(self, most: int) -> None:
        self._most = most
        self._entries: list[Sent] = []
        self._trim_at = _STEP
        # Number of entries whose memory is counted, from the oldest one, and this memory in bytes. A record of ten
        # seconds has thousands of entries, so `_trim` counts only the new ones.
        self._counted = (0, 0)
        self._trimming = threading.Lock()

    def keep(self, channel: str, data: bytes | memoryview) -> None:
        """Record the bytes of one call of `send`."""
        now = clock.now()
        self._entries.append(Sent(now, channel, bytes(data[:LONGEST])))
        # While the lock is taken, another thread trims the record, or the code that a signal handler has interrupted.
        if len(self._entries) >= self._trim_at and self._trimming.acquire(blocking=False):
            try:
                self._trim(now)
            finally:
                self._trimming.release()

    def _trim(self, now: float) -> None:
        entries = self._entries  # other threads only append entries
        counted, size = self._counted
        count, first = len(entries), 0
        size += sum(map(_memory, entries[counted:count]))
        while first < count and (size > self._most or entries[first].time < now - SECONDS):
            size -= _memory(entries[first])
            first += 1
        del entries[:first]
        self._counted = (count - first, size)
        self._trim_at = count - first + _STEP

    @property
    def messages(self) -> Sequence[Sent]:
        """Copy of the record, with the oldest message first."""
        return list(self._entries)

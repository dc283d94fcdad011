"""Corruption of a byte stream: tails, unknown packages, garbage, other segments. Pure functions.

The results look like the bytes of a newer controller, of a broken one, or of a bad network.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import cycle

from ..ports.form import package

__all__ = ["Segmenter", "with_garbage_inside", "with_sub_package", "with_tail", "with_tails"]


def with_tail(packet: bytes, tail: bytes) -> bytes:
    """A real-time packet as of a newer release that appends `tail` to it."""
    return (len(packet) + len(tail)).to_bytes(4, "big") + packet[4:] + tail


def with_tails(state: bytes, tail: bytes) -> bytes:
    """A robot state in which every sub-package has grown by `tail`."""
    parts = []
    offset = 5
    while offset < len(state):
        size = int.from_bytes(state[offset : offset + 4], "big")
        parts.append(package(state[offset + 4], state[offset + 5 : offset + size] + tail))
        offset += size
    return package(state[4], b"".join(parts))


def with_sub_package(state: bytes, kind: int, payload: bytes) -> bytes:
    """A robot state with one more sub-package at its end."""
    return package(state[4], state[5:] + package(kind, payload))


def with_garbage_inside(packet: bytes, garbage: bytes) -> bytes:
    """A packet with bytes in its middle that its size does not count: the fields after them are shifted."""
    half = len(packet) // 2
    return packet[:half] + garbage + packet[half:]


class Segmenter:
    """Cuts the stream of one connection into segments that are independent of its packets.

    >>> cut = Segmenter(sizes=[4, 2])
    >>> cut.put(b"abcde"), cut.put(b"fghij"), cut.rest()
    ([b'abcd'], [b'ef', b'ghij'], b'')

    Args:
        sizes: the stream is cut into segments of these sizes, in turn. The rest of a packet that does not fill one
            waits, so the cuts move through the packets.
        count: this many packets make one segment. Not together with `sizes`.
    """

    def __init__(self, sizes: Sequence[int] = (), count: int = 1) -> None:
        self._sizes = cycle(sizes) if sizes else None
        self._size = next(self._sizes) if self._sizes is not None else 0
        self._count = count
        self._waiting = 0
        self._held = b""

    def put(self, packet: bytes) -> list[bytes]:
        """Add a packet; returns the segments that can be sent."""
        self._held += packet
        if self._sizes is None:
            self._waiting += 1
            if self._waiting < self._count:
                return []
            return [self.rest()]
        ready = []
        while len(self._held) >= self._size:
            ready.append(self._held[: self._size])
            self._held = self._held[self._size :]
            self._size = next(self._sizes)
        return ready

    def rest(self) -> bytes:
        """The bytes that were kept back, to be sent unchanged."""
        held, self._held, self._waiting = self._held, b"", 0
        return held

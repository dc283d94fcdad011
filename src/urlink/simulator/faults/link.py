"""Faults of the connections: silence, cut connections, segments, and unexpected bytes.

For each packet, this module returns the bytes that the server sends instead. These bytes look as if they came from a
newer controller, from a broken controller, or through a bad network. The controller itself keeps running.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Sequence, Set
from itertools import cycle
from typing import TypeVar

from linkcore.deferred import Deferred

from ...protocol.ports import PORTS, interface_of
from ..interfaces.interface import package

P = TypeVar("P", bytes, "bytes | Deferred")

#: Maximum number of calls of `insert` that are queued for the next packet of a port. If there are more, the oldest are
#: dropped.
_WAITING = 16


def with_tail(packet: bytes, tail: bytes) -> bytes:
    """Return a real-time packet with `tail` appended, as a newer release sends it."""
    return (len(packet) + len(tail)).to_bytes(4, "big") + packet[4:] + tail


def with_tails(state: bytes, tail: bytes) -> bytes:
    """Return a robot state with `tail` appended to every sub-package."""
    parts = []
    offset = 5
    while offset < len(state):
        size = int.from_bytes(state[offset : offset + 4], "big")
        parts.append(package(state[offset + 4], state[offset + 5 : offset + size] + tail))
        offset += size
    return package(state[4], b"".join(parts))


def with_sub_package(state: bytes, kind: int, payload: bytes) -> bytes:
    """Return a robot state with an additional sub-package at its end."""
    return package(state[4], state[5:] + package(kind, payload))


def with_garbage_inside(packet: bytes, garbage: bytes) -> bytes:
    """Return a packet with `garbage` in its middle, which the size field of the packet does not count.

    The fields after the garbage are therefore at wrong positions.
    """
    half = len(packet) // 2
    return packet[:half] + garbage + packet[half:]


class Segmenter:
    """Segmenter that divides the bytes of one connection into segments, which do not end where packets end.

    >>> cut = Segmenter(sizes=[4, 2])
    >>> cut.put(b"abcde"), cut.put(b"fghij"), cut.rest()
    ([b'abcd'], [b'ef', b'ghij'], b'')

    Args:
        sizes: Sizes of the segments, used in turn. If the rest of a packet does not fill a segment, the rest is sent
            together with the next packet. So the position at which a packet is divided differs from packet to packet.
        count: Number of packets that are joined to one segment. It is ignored if `sizes` is given.
    """

    def __init__(self, sizes: Sequence[int] = (), count: int = 1) -> None:
        self._sizes = cycle(sizes) if sizes else None
        self._size = next(self._sizes) if self._sizes is not None else 0
        self._count = count
        self._waiting = 0
        self._held = b""

    def put(self, packet: bytes) -> list[bytes]:
        """Add a packet, and return the segments that can be sent."""
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
        """Return and remove the buffered bytes, which must be sent as they are."""
        held, self._held, self._waiting = self._held, b"", 0
        return held


_NO_PORTS: frozenset[str] = frozenset()


class LinkFaults:
    """Faults of all ports of one controller. Use this object only in the thread that owns the controller.

    Args:
        cycle: Function that returns the number of the current cycle.

    Attributes:
        segments_changed: Number that changes whenever the segment settings of any port change.
    """

    def __init__(self, cycle: Callable[[], int]) -> None:
        self.segments_changed = 0
        self._cycle = cycle
        # Whether any packet might be sent in a changed form, since the last call of `heal`.
        self._has_changes = False
        self._stalled_until: dict[str, int] = {}
        self._cuts: set[str] = set()
        self._segments: dict[str, tuple[tuple[int, ...], int]] = {}
        self._tails: dict[str, bytes] = {}
        self._sub_packages: dict[str, tuple[int, bytes]] = {}
        # The queues are bounded, because a port without a client sends no packet that would empty them.
        self._before: dict[str, deque[bytes]] = {name: deque(maxlen=_WAITING) for name in PORTS}
        self._inside: dict[str, deque[bytes]] = {name: deque(maxlen=_WAITING) for name in PORTS}

    # -- faults to cause ---------------------------------------------------------------------------

    def cut(self, ports: Iterable[str]) -> None:
        """Reset the connections to these ports."""
        self._cuts.update(ports)

    def stall(self, ports: Iterable[str], cycles: int) -> None:
        """Send nothing on these ports for this number of cycles."""
        self._stalled_until.update(dict.fromkeys(ports, self._cycle() + cycles))

    def segment(self, ports: Iterable[str], sizes: tuple[int, ...], count: int) -> None:
        """Divide or join the packets that these ports send; see `Segmenter`."""
        self._segments.update(dict.fromkeys(ports, (sizes, count)))
        self.segments_changed += 1

    def insert(self, ports: Iterable[str], data: bytes, inside: bool = False) -> None:
        """Once, send these bytes before the next packet of each port, or in the middle of this packet."""
        for name in ports:
            (self._inside if inside else self._before)[name].append(data)
        self._has_changes = True

    def append(self, ports: Iterable[str], tail: bytes) -> None:
        """Append a tail to all packets of these ports."""
        self._tails.update(dict.fromkeys(ports, tail))
        self._has_changes = True

    def add_sub_package(self, ports: Iterable[str], kind: int, payload: bytes) -> None:
        """Append a sub-package to all robot states of these ports."""
        self._sub_packages.update(dict.fromkeys(ports, (kind, payload)))
        self._has_changes = True

    def heal(self) -> None:
        """End all faults."""
        self._has_changes = False
        self._stalled_until.clear()
        self._cuts.clear()
        self._segments.clear()
        self.segments_changed += 1
        self._tails.clear()
        self._sub_packages.clear()
        for waiting in (*self._before.values(), *self._inside.values()):
            waiting.clear()

    # -- for the server ----------------------------------------------------------------------------

    def is_stalled(self, port: str) -> bool:
        """Whether this port is currently silent."""
        return self._cycle() < self._stalled_until.get(port, 0)

    @property
    def is_any_stalled(self) -> bool:
        """Whether any port is currently silent."""
        return bool(self._stalled_until) and self._cycle() < max(self._stalled_until.values())

    def take_cuts(self) -> Set[str]:
        """Return and clear the ports whose connections must be reset now."""
        if not self._cuts:
            return _NO_PORTS
        cuts, self._cuts = self._cuts, set()
        return cuts

    def segmenter(self, port: str) -> Segmenter | None:
        """Return a new segmenter for a connection to this port; None if packets are sent unchanged."""
        rule = self._segments.get(port)
        return None if rule is None else Segmenter(*rule)

    def lasting(self, port: str, packet: P) -> P | bytes:
        """Return a packet with the lasting faults applied: tails and unknown sub-packages."""
        tail = self._tails.get(port)
        if interface_of(port) == "realtime":
            return packet if tail is None else with_tail(bytes(packet), tail)
        added = self._sub_packages.get(port)
        if (tail is None and added is None) or interface_of(port) not in ("primary", "secondary"):
            return packet
        state = bytes(packet)
        if state[4] != 16:
            return packet
        if tail is not None:
            state = with_tails(state, tail)
        return state if added is None else with_sub_package(state, *added)

    def on_the_wire(self, port: str, packet: bytes | Deferred) -> bytes | Deferred:
        """Return the bytes that this port sends instead of a packet. Without a fault, this is the same packet.

        Faults that happen only once are removed afterwards.
        """
        if not self._has_changes:
            return packet
        packet = self.lasting(port, packet)
        inside, before = self._inside[port], self._before[port]
        if inside:
            packet = with_garbage_inside(bytes(packet), b"".join(inside))
            inside.clear()
        if before:
            packet = b"".join(before) + bytes(packet)
            before.clear()
        return packet

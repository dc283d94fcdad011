"""Bytes cut at the frame boundaries, including the bytes between frames."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import NamedTuple

from linkcore.errors import WrongPeer
from linkcore.wire.framing import Framer

from ..decoding import Interface
from ..interfaces.primary.framing import PackageBoundary
from ..interfaces.realtime.framing import RealtimeBoundary

__all__ = ["Stretch", "cut", "guess_interface"]

_BOUNDARIES: dict[Interface, Callable[[], PackageBoundary | RealtimeBoundary]] = {
    "primary": PackageBoundary,
    "realtime": RealtimeBoundary,
}


class Stretch(NamedTuple):
    """A part of a stream of bytes.

    Attributes:
        offset: in the stream.
        data: the bytes.
        is_packet: whether it is a whole packet; if not, its bytes belong to none.
        expected: size of the packet that begins here and is cut off; None otherwise.
    """

    offset: int
    data: bytes
    is_packet: bool
    expected: int | None = None


def cut(data: bytes, interface: Interface) -> Iterator[Stretch]:
    """Every byte of `data`, in order, as whole packets and the bytes between, before and after them."""
    boundary = _BOUNDARIES["realtime" if interface == "realtime" else "primary"]()
    framer = Framer(boundary, limit=None)  # no limit: all bytes are shown, whatever they are
    at = 0
    for frame in framer.feed(data) if data else ():
        start = data.index(frame, at)
        if start > at:
            yield Stretch(at, data[at:start], is_packet=False)
        yield Stretch(start, frame, is_packet=True)
        at = start + len(frame)
    rest = len(data) - len(framer.rest)
    if rest > at:
        yield Stretch(at, data[at:rest], is_packet=False)
    if framer.rest:
        size, _ = boundary.declared(framer.rest, 0)
        if 0 < size <= len(framer.rest):
            # Whole, but unusual: the framer would wait for the next header to confirm it.
            yield Stretch(rest, framer.rest[:size], is_packet=True)
            rest, size = rest + size, 0
        if rest < len(data):
            yield Stretch(rest, data[rest:], is_packet=False, expected=size or None)


def guess_interface(data: bytes) -> Interface | None:
    """The interface whose packets fill most of `data`; None if no packet of any is in it."""
    found = {interface: _filled(data, interface) for interface in _BOUNDARIES}
    # The primary interface is preferred if both are possible: its packets have more marks than their size.
    best = max(found, key=lambda interface: found[interface])
    return best if found[best] else None


def _filled(data: bytes, interface: Interface) -> int:
    """Bytes in whole packets, or in the beginning of the one packet that `data` is."""
    try:
        Framer(_BOUNDARIES[interface]()).feed(data)
    except WrongPeer:
        return 0
    return sum(len(each.data) for each in cut(data, interface) if each.is_packet or each.expected is not None)

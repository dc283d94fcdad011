"""Bytes cut at the frame boundaries, with what lies between them: nothing is left out."""

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
        is_packet: a whole packet; otherwise bytes that belong to none.
        expected: size of the packet that begins here and is cut off, or None.
    """

    offset: int
    data: bytes
    is_packet: bool
    expected: int | None = None


def cut(data: bytes, interface: Interface) -> Iterator[Stretch]:
    """Every byte of `data`, in order, as whole packets and what is between, before and after them."""
    boundary = _BOUNDARIES["realtime" if interface == "realtime" else "primary"]()
    framer = Framer(boundary, limit=None)  # whatever comes, somebody wants to see it
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
            # Whole, but so odd that the framer has to see the next header before it believes it.
            yield Stretch(rest, framer.rest[:size], is_packet=True)
            rest, size = rest + size, 0
        if rest < len(data):
            yield Stretch(rest, data[rest:], is_packet=False, expected=size or None)


def guess_interface(data: bytes) -> Interface | None:
    """The interface whose packets fill most of `data`; None where no packet of any is in it."""
    found = {interface: _filled(data, interface) for interface in _BOUNDARIES}
    # The primary interface wins where both are possible: it knows its packets by more than their size.
    best = max(found, key=lambda interface: found[interface])
    return best if found[best] else None


def _filled(data: bytes, interface: Interface) -> int:
    """Bytes of whole packets, or of the one that `data` is the beginning of."""
    try:
        Framer(_BOUNDARIES[interface]()).feed(data)
    except WrongPeer:
        return 0
    return sum(len(each.data) for each in cut(data, interface) if each.is_packet or each.expected is not None)

"""Headers and possible sizes of the packets of each interface, and the first bytes that identify a peer.

All interfaces share this module, because the client of each interface recognises a peer on the wrong port.
Sources: docs/protocols/realtime.md and primary.md, sections Framing; docs/protocols/dashboard.md, section Lines.
"""

from __future__ import annotations

from linkcore.wire.fields import Header, Int8ub, Int32sb

#: Header of the real-time interface, which contains only the size. No byte holds the type of packet.
REALTIME = Header(size=Int32sb)

#: Header of packages and sub-packages of the primary and secondary interface. The size includes the header.
PACKAGE = Header(size=Int32sb, type=Int8ub)

#: Valid real-time sizes, which are 4 + 8k. A size outside this range, or with another remainder, means a lost boundary.
REALTIME_SIZES = range(500, 4097)

#: Valid package sizes. The largest observed package is 1471 bytes; program state grows with the user's variables.
PACKAGE_SIZES = range(5, 65537)

#: First bytes that the dashboard server sends.
DASHBOARD_GREETING = b"Connected: Universal"

REALTIME_INTERFACE = "the real-time interface (port 30003)"
PACKAGE_INTERFACE = "a primary or secondary interface (port 30001 or 30002)"
_DASHBOARD = "the dashboard server (port 29999)"

#: Types of packages. At this position, a real-time packet has the first byte of a time: 0x00, or 0x3f and above.
ROBOT_STATE, ROBOT_MESSAGE = 0x10, 0x14


def interface_of(first: bytes | bytearray) -> str | None:
    """Return the interface that sends these first bytes (at least five), or None if no known interface does."""
    if DASHBOARD_GREETING.startswith(bytes(first[: len(DASHBOARD_GREETING)])):
        return _DASHBOARD
    size, kind = int.from_bytes(first[:4], "big"), first[4]
    if size in PACKAGE_SIZES and kind in (ROBOT_STATE, ROBOT_MESSAGE):
        return PACKAGE_INTERFACE
    if size in REALTIME_SIZES and size % 8 == 4:
        return REALTIME_INTERFACE
    return None

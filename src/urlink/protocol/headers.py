"""How the packets of each interface begin: headers, possible sizes, and by which bytes a peer is recognised.

Shared by the interfaces, since each of them reports a connection to the wrong port.
Sources: docs/protocols/realtime.md and primary.md, sections Framing; docs/protocols/dashboard.md, section Lines.
"""

from __future__ import annotations

from linkcore.wire.fields import Header, Int8ub, Int32sb

#: Real-time interface: the size and nothing else. No byte holds the type of packet.
REALTIME = Header(size=Int32sb)

#: Primary and secondary interface, packages and sub-packages alike. The size counts the header.
PACKAGE = Header(size=Int32sb, type=Int8ub)

#: Real-time sizes are 4 + 8k. Outside this range, or with another remainder, the frame boundary is lost.
REALTIME_SIZES = range(500, 4097)

#: The largest package seen is 1471 bytes; program state grows with the user's variables.
PACKAGE_SIZES = range(5, 65537)

#: The first bytes of the dashboard server.
DASHBOARD_GREETING = b"Connected: Universal"

REALTIME_INTERFACE = "the real-time interface (port 30003)"
PACKAGE_INTERFACE = "a primary or secondary interface (port 30001 or 30002)"
_DASHBOARD = "the dashboard server (port 29999)"

#: Types of packages. In place of that byte, a real-time packet has the top of a time: 0x00, or 0x3f and up.
ROBOT_STATE, ROBOT_MESSAGE = 0x10, 0x14


def interface_of(first: bytes | bytearray) -> str | None:
    """The interface whose connections begin with such bytes, five or more; None for no interface of a controller."""
    if DASHBOARD_GREETING.startswith(bytes(first[: len(DASHBOARD_GREETING)])):
        return _DASHBOARD
    size, kind = int.from_bytes(first[:4], "big"), first[4]
    if size in PACKAGE_SIZES and kind in (ROBOT_STATE, ROBOT_MESSAGE):
        return PACKAGE_INTERFACE
    if size in REALTIME_SIZES and size % 8 == 4:
        return REALTIME_INTERFACE
    return None

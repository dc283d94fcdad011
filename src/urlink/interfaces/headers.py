"""What precedes the fields of each kind of packet, and the sizes between which one can be true."""

from __future__ import annotations

from construct import Int8ub, Int32sb, Struct

__all__ = ["DASHBOARD_GREETING", "PACKAGE", "PACKAGE_SIZES", "REALTIME", "REALTIME_SIZES"]

#: Real-time interface: the size and nothing else. No byte tells the type of packet.
REALTIME = Struct("size" / Int32sb)

#: Primary and secondary interface, packages and sub-packages alike. The size counts the header.
PACKAGE = Struct("size" / Int32sb, "type" / Int8ub)

#: Real-time sizes are 4 + 8k; outside this range, or with another remainder, the border is lost.
REALTIME_SIZES = range(500, 4097)

#: The largest package seen is 1471 bytes; program state grows with the user's variables.
PACKAGE_SIZES = range(5, 65537)

#: What the dashboard server (port 29999) begins with: somebody took the wrong port.
DASHBOARD_GREETING = b"Connected: Universal"

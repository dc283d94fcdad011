"""The six ports of the client interfaces."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

__all__ = ["PORTS", "interface"]

#: name -> the number it has on a real controller
PORTS: Mapping[str, int] = MappingProxyType(
    {
        "primary": 30001,
        "secondary": 30002,
        "realtime": 30003,
        "primary_readonly": 30011,
        "secondary_readonly": 30012,
        "realtime_readonly": 30013,
    }
)


def interface(port: str) -> str:
    """Which of primary, secondary and realtime a port speaks: its own, or that of which it is the read-only twin."""
    return port.removesuffix("_readonly")

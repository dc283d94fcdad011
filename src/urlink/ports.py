"""The ports of the client interfaces, of the dashboard and of the Robot API, and of the gripper's URCap."""

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
        "rtde": 30004,
        "dashboard": 29999,
        "robot_api": 80,
        "interpreter": 30020,
        "gripper": 63352,
    }
)


def interface(port: str) -> str:
    """The interface of a port: its own name; of a read-only port, that of its writable twin."""
    return port.removesuffix("_readonly")

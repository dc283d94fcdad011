"""Ports of controllers (client interfaces, dashboard, Robot API, URCaps), and a hint why a port is closed.

On firmware 5.17 or later, and on PolyScope X, the ports of the client interfaces are closed until a person switches
their services on at the pendant (docs/protocols/urscript.md, Services that are off).
"""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from types import MappingProxyType
from typing import Literal, get_args

from .firmware import Firmware

#: Name of the port -> its number on a real controller, or on a device of its tool.
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
        "tool_serial": 54321,
        # Port of OnRobot's Compute Box, which has its own address. A simulated controller serves it itself.
        "onrobot": 502,
    }
)

#: Client interfaces that send typed states.
Interface = Literal["realtime", "primary", "secondary"]
INTERFACES: tuple[Interface, ...] = get_args(Interface)


def interface_of(port: str) -> str:
    """Return the interface of a port name. A read-only port belongs to the same interface as its writable port."""
    return port.removesuffix("_readonly")


def service_of(host: str, port: int) -> Hashable:
    """Return the key that identifies a service within this process."""
    return host.casefold(), port


_WHERE = "the service might be switched off (Settings > Security > Services at the pendant)"
_SINCE = Firmware(5, 17)


def refusal_hint(firmware: Firmware | None) -> str:
    """Return a hint for a refused connection; "" if the firmware cannot switch services off.

    Args:
        firmware: Firmware of the controller; None if it is unknown.

    >>> refusal_hint(Firmware(5, 25))
    'on firmware 5.25 the service might be switched off (Settings > Security > Services at the pendant)'
    >>> refusal_hint(Firmware(5, 11))
    ''
    """
    if firmware is None:
        return f"on firmware {_SINCE} or later, and on PolyScope X, {_WHERE}"
    return f"on firmware {firmware} {_WHERE}" if firmware >= _SINCE else ""

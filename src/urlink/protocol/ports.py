"""The ports of controllers: client interfaces, dashboard, Robot API and those of URCaps; and why one is closed.

From 5.17 on, and on PolyScope X, the ports of the client interfaces are closed until a person switches their services
on at the pendant (docs/protocols/urscript.md, Services that are off).
"""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from types import MappingProxyType
from typing import Literal, get_args

from .firmware import Firmware

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
        "tool_serial": 54321,
    }
)

#: Those of the client interfaces on which typed states come.
Interface = Literal["realtime", "primary", "secondary"]
INTERFACES: tuple[Interface, ...] = get_args(Interface)


def interface_of(port: str) -> str:
    """The interface of a port: its own name; of a read-only port, that of its writable twin."""
    return port.removesuffix("_readonly")


def service_of(host: str, port: int) -> Hashable:
    """By what this process knows a service again."""
    return host.casefold(), port


_WHERE = "the service may be switched off (Settings > Security > Services at the pendant)"
_SINCE = Firmware(5, 17)


def refusal_hint(firmware: Firmware | None) -> str:
    """The hint for a connection that a controller refuses; "" for a controller without a setting for it.

    Args:
        firmware: of the controller; None where nobody knows it.

    >>> refusal_hint(Firmware(5, 25))
    'on firmware 5.25 the service may be switched off (Settings > Security > Services at the pendant)'
    >>> refusal_hint(Firmware(5, 11))
    ''
    """
    if firmware is None:
        return f"from firmware {_SINCE} on, and on PolyScope X, {_WHERE}"
    return f"on firmware {firmware} {_WHERE}" if firmware >= _SINCE else ""

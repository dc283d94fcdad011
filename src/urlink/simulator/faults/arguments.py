"""Checks of the arguments of faults, from a program or from a command line."""

from __future__ import annotations

import math
from collections.abc import Sequence

from linkcore.errors import BadValue
from urlink.ports import PORTS, interface

__all__ = ["checked_seconds", "checked_sizes", "package_ports", "port_names", "request_byte", "type_byte"]


def port_names(port: str | None) -> tuple[str, ...]:
    """The one port of that name, or all of them.

    Raises:
        BadValue: there is no such port.
    """
    if port is None:
        return tuple(PORTS)
    if port not in PORTS:
        raise BadValue(f"no port is called {port!r}; there are {', '.join(PORTS)}")
    return (port,)


def package_ports(port: str | None) -> tuple[str, ...]:
    """Those of `port_names` whose packages have a type.

    Raises:
        BadValue: none of them.
    """
    names = tuple(name for name in port_names(port) if interface(name) in ("primary", "secondary"))
    if not names:
        raise BadValue(f"{port} has no packages with types")
    return names


def type_byte(kind: int) -> int:
    """The type of a package.

    Raises:
        BadValue: it is not 0 to 255.
    """
    if kind not in range(256):
        raise BadValue(f"a type is a byte, not {kind!r}")
    return kind


def request_byte(letter: str) -> int:
    """The type of a request of an RTDE client, by its letter.

    Raises:
        BadValue: none of those that are answered.
    """
    if len(letter) != 1 or letter not in "VvOISP":
        raise BadValue(f"a request is V, v, O, I, S or P, not {letter!r}")
    return ord(letter)


def checked_seconds(seconds: float) -> float:
    """A time.

    Raises:
        BadValue: it is negative or not finite.
    """
    if not 0.0 <= seconds < math.inf:
        raise BadValue(f"a time is zero or more seconds, not {seconds!r}")
    return float(seconds)


def checked_sizes(sizes: Sequence[int]) -> tuple[int, ...]:
    """Segment sizes that can be cut.

    Raises:
        BadValue: none, or not all of them whole numbers of at least one byte.
    """
    if not sizes or any(not isinstance(size, int) or size < 1 for size in sizes):
        raise BadValue(f"segment sizes are whole numbers of bytes, at least 1, not {sizes!r}")
    return tuple(sizes)

"""Access to packet fields by their names on the command line, and conversion of their values to text and JSON."""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Iterable, Mapping
from typing import Any

import numpy as np

from linkcore.text import printable
from linkcore.wire.fields import OpenInt
from linkcore.wire.state import State, plain

from ..protocol.primary.robot_message import OtherPackage
from ..protocol.primary.robot_state import SUB_PACKAGES, RobotState, UnknownSubPackage, snake_case
from ..protocol.realtime.packets import RealtimeState


class NoSuchField(ValueError):
    """Error: packets of this class do not have such a field."""


def field_names(kind: type[State]) -> list[str]:
    """Return the paths of all fields of packets of class `kind`."""
    if kind is not RobotState:
        return list(kind.FIELDS)
    parts = [part for classes in SUB_PACKAGES.values() for part in classes if part is not UnknownSubPackage]
    return [f"{snake_case(part.__name__)}.{name}" for part in parts for name in part.FIELDS]


def getter(kind: type[State], path: str) -> Callable[[Any], Any]:
    """Return a function that reads the field `path` of a packet.

    The function returns None if the packet does not contain the field.

    Raises:
        NoSuchField: If there is no such field. The message lists the existing fields.
    """
    names = field_names(kind)
    parts = {name.partition(".")[0] for name in names if "." in name}
    if path not in names and path not in parts:
        raise NoSuchField(_complaint(kind, path, names))
    first, _, second = path.partition(".")

    def get(packet: Any) -> Any:
        value = getattr(packet, first, None)
        return getattr(value, second, None) if second else value

    return get


def _complaint(kind: type[State], path: str, names: list[str]) -> str:
    near = [name for name in names if name.rpartition(".")[2] == path]
    hint = f"; did you mean {' or '.join(near)}?" if near else ""
    words = " ".join(names) or "nothing: choose a class with --type"
    there = textwrap.fill(words, 101, initial_indent="  ", subsequent_indent="  ")
    other = "" if near or kind is RealtimeState else "\nFields of the real-time state need --interface realtime."
    return f"{kind.__name__} has no field {path!r}{hint}\nIts fields are:\n{there}{other}"


def as_json(packet: State, getters: Mapping[str, Callable[[Any], Any]] | None = None) -> dict[str, Any]:
    """Convert a packet to a JSON object: type, time of arrival (seconds since 1970), and fields.

    The object contains the fields of `getters`, or all fields if `getters` is None.
    """
    received = packet.received
    head = {"type": type(packet).__name__, "received": None if received is None else received.wall}
    if getters:
        return head | {path: _shown(get(packet)) for path, get in getters.items()}
    return head | _content(packet)


def _shown(value: Any) -> Any:
    """Convert the value of a field, or a whole sub-package, for JSON."""
    return _content(value) if isinstance(value, State) else plain(value)


def _content(packet: State) -> dict[str, Any]:
    if isinstance(packet, RobotState):
        known = [part for part in packet if not isinstance(part, UnknownSubPackage)]
        content: dict[str, Any] = {snake_case(type(part).__name__): _content(part) for part in known}
        unknown = [_content(part) for part in packet if isinstance(part, UnknownSubPackage)]
        # There can be several unknown sub-packages, so their class name cannot be the key.
        return content | {"unknown_sub_packages": unknown} if unknown else content
    content = packet.to_dict()
    if isinstance(packet, (UnknownSubPackage, OtherPackage)):
        content = {"package_type": int(packet.type), **content}
    if packet.tail:
        content["tail"] = packet.tail.hex()
    return content


def as_text(value: Any) -> str:
    """Format the value of a field for one line; control characters from the wire are escaped."""
    if value is None:
        return "-"
    if isinstance(value, OpenInt):
        return str(value.name)
    if isinstance(value, (float, np.floating)):
        return f"{value:.6g}"
    if isinstance(value, (np.ndarray, tuple, list)):
        return "[" + ", ".join(map(as_text, value)) + "]"
    if isinstance(value, (bytes, bytearray)):
        return value.hex()
    return printable(repr(value)) if isinstance(value, str) else printable(str(value))


def as_line(packet: State) -> str:
    """Format a packet with its tail as one line."""
    tail = f" tail={packet.tail.hex()}" if packet.tail else ""
    return printable(str(packet)) + tail


def joints_text(q: Iterable[float]) -> str:
    """Format joint positions, in rad, as one line."""
    return f"q: {', '.join(f'{each:.4f}' for each in q)}"

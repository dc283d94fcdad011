"""Packets and their fields as text and as JSON."""

from __future__ import annotations

from typing import Any

import numpy as np

from linkcore.text import printable
from linkcore.wire.packet import State
from linkcore.wire.shapes import OpenInt

from ..interfaces.primary.robot_message import OtherPackage
from ..interfaces.primary.robot_state import RobotState, UnknownSubPackage, snake_case

__all__ = ["as_json", "as_line", "as_text", "plain"]


def plain(value: Any) -> Any:
    """A field's value for JSON: codes by name, bytes in hex."""
    if isinstance(value, State):
        return _content(value)
    if isinstance(value, (np.ndarray, np.generic)):
        return value.tolist()
    if isinstance(value, (tuple, list)):
        return [plain(element) for element in value]
    if isinstance(value, OpenInt):
        return value.name
    return value.hex() if isinstance(value, (bytes, bytearray)) else value


def as_json(packet: State) -> dict[str, Any]:
    """A packet as a JSON object: its type, when it arrived (seconds since 1970), its fields."""
    received = packet.received
    head = {"type": type(packet).__name__, "received": None if received is None else received.wall}
    return head | _content(packet)


def _content(packet: State) -> dict[str, Any]:
    if isinstance(packet, RobotState):
        known = [part for part in packet if not isinstance(part, UnknownSubPackage)]
        content: dict[str, Any] = {snake_case(type(part).__name__): _content(part) for part in known}
        unknown = [_content(part) for part in packet if isinstance(part, UnknownSubPackage)]
        # There can be several of them, so their name cannot be the key.
        return content | {"unknown_sub_packages": unknown} if unknown else content
    content = packet.to_dict()
    if isinstance(packet, (UnknownSubPackage, OtherPackage)):
        content = {"package_type": int(packet.type), **content}
    if packet.tail:
        content["tail"] = packet.tail.hex()
    return content


def as_text(value: Any) -> str:
    """A field's value for one line; control characters from the wire are escaped."""
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
    """A packet on one line, with its tail."""
    tail = f" tail={packet.tail.hex()}" if packet.tail else ""
    return printable(str(packet)) + tail

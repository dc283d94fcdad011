"""Packet classes and their fields, by the names that are used on the command line."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

from linkcore.wire.packet import State

from ..interfaces.primary.robot_state import SUB_PACKAGES, RobotState, UnknownSubPackage, snake_case
from ..interfaces.realtime.packets import RealtimeState

__all__ = ["NoSuchField", "field_names", "getter"]


class NoSuchField(ValueError):
    """A field that packets of the class do not have."""


def field_names(kind: type[State]) -> list[str]:
    """The paths of the fields of packets of class `kind`."""
    if kind is not RobotState:
        return list(kind.FIELDS)
    parts = [part for classes in SUB_PACKAGES.values() for part in classes if part is not UnknownSubPackage]
    return [f"{snake_case(part.__name__)}.{name}" for part in parts for name in part.FIELDS]


def getter(kind: type[State], path: str) -> Callable[[Any], Any]:
    """A function from a packet to the field called `path`; it returns None if the packet does not have it.

    Raises:
        NoSuchField: no such field; the message lists those that there are.
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
    there = "\n".join(_wrapped(names)) or "  nothing: choose a class with --type"
    other = "" if kind is RealtimeState else "\nReal-time fields need --interface realtime."
    return f"{kind.__name__} has no field {path!r}{hint}\nIt has:\n{there}{other if not near else ''}"


def _wrapped(names: list[str]) -> Iterator[str]:
    line = " "
    for name in names:
        if len(line) + len(name) > 100:
            yield line
            line = " "
        line += f" {name}"
    if line.strip():
        yield line

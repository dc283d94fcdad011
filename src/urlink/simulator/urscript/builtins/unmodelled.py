"""Functions of a controller that are not modelled: a program with them compiles, and calling one is a run-time error.

A function that becomes modelled moves to its family. Which firmware introduced each is left open, except that CB2
certainly has none.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from ..errors import Fault
from ..machine import ScriptThread
from .declaration import Family

__all__ = ["FAMILY"]

FAMILY = Family()

_NETWORK = [
    "eip_reader_factory",
    "eip_writer_factory",
]
#: In public programs, but in no manual as far as they are remembered.
_UNKNOWN = ["tool_pose"]
_CONVEYOR = [
    "encoder_enable_pulse_decode",
    "get_conveyor_tick_count",
    "stop_conveyor_tracking",
    "track_conveyor_linear",
]


def _unmodelled(name: str, what: str) -> Callable[..., Any]:
    def stop(thread: ScriptThread, *arguments: Any) -> None:
        raise Fault(f"{name}: {what} not modelled by this simulator")

    return stop


for _names, _what in (
    (_NETWORK, "EtherNet/IP is"),
    (_CONVEYOR, "conveyors are"),
    (_UNKNOWN, "what it gives is not known, and it is"),
):
    for _name in _names:
        FAMILY.declare(name=_name, since="3.0")(_unmodelled(_name, _what))

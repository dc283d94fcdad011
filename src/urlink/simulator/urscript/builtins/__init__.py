"""Built-in functions of URScript; each module contains one family of functions."""

from __future__ import annotations

from urlink.protocol.firmware import Firmware

# These modules declare functions when they are imported.
from . import (  # noqa: F401
    force,
    inputs_outputs,
    mathematics,
    modbus,
    motions,
    poses,
    program,
    queries,
    registers,
    remote_procedures,
    sockets,
)
from .declaration import BUILTINS, Builtin

__all__ = ["BUILTINS", "find"]


def find(name: str, firmware: Firmware) -> Builtin | None:
    """Return the built-in function with this name; None if the firmware has no such function."""
    return next((each for each in BUILTINS.get(name, ()) if each.is_in(firmware)), None)

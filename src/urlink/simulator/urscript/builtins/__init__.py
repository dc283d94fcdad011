"""Built-in functions of a controller, one module for each family."""

from __future__ import annotations

from urlink.protocol.firmware import Firmware

# Import these modules, because they declare functions.
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
    """Return the function of that name in a firmware; None if there is none."""
    return next((each for each in BUILTINS.get(name, ()) if each.is_in(firmware)), None)

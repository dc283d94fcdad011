"""The built-in functions of a controller, one module for each family."""

from __future__ import annotations

from urlink.firmware import Firmware

from . import (
    dynamics,
    force,
    inputs_outputs,
    lists_and_strings,
    mathematics,
    modbus,
    motions,
    poses,
    program,
    queries,
    registers,
    remote_procedures,
    sockets,
    unmodelled,
)
from .declaration import Builtin, Family

__all__ = ["FAMILIES", "find"]

FAMILIES: tuple[Family, ...] = (
    lists_and_strings.FAMILY,
    mathematics.FAMILY,
    modbus.FAMILY,
    motions.FAMILY,
    poses.FAMILY,
    program.FAMILY,
    inputs_outputs.FAMILY,
    registers.FAMILY,
    remote_procedures.FAMILY,
    sockets.FAMILY,
    queries.FAMILY,
    dynamics.FAMILY,
    force.FAMILY,
    unmodelled.FAMILY,
)


def find(name: str, firmware: Firmware) -> Builtin | None:
    """The function of that name in a firmware; None if it has none."""
    for family in FAMILIES:
        for builtin in family.functions.get(name, ()):
            if builtin.is_in(firmware):
                return builtin
    return None

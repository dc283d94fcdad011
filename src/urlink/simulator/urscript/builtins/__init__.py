"""The built-in functions of a controller, one module for each family."""

from __future__ import annotations

from urlink.firmware import Firmware

from . import (
    force,
    inputs_outputs,
    mathematics,
    motions,
    poses,
    program,
    queries,
    registers,
    remote_procedures,
    sockets,
)
from .declaration import Builtin, Family

__all__ = ["FAMILIES", "find"]

FAMILIES: tuple[Family, ...] = (
    mathematics.FAMILY,
    motions.FAMILY,
    poses.FAMILY,
    program.FAMILY,
    inputs_outputs.FAMILY,
    registers.FAMILY,
    remote_procedures.FAMILY,
    sockets.FAMILY,
    queries.FAMILY,
    force.FAMILY,
)


def find(name: str, firmware: Firmware) -> Builtin | None:
    """The function of that name in a firmware; None if it has none."""
    for family in FAMILIES:
        for builtin in family.functions.get(name, ()):
            if builtin.is_in(firmware):
                return builtin
    return None

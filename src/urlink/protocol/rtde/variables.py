"""Table of all RTDE variables (`variables.tsv`). The client, the simulator and the documentation use it.

Sources: the vendor's RTDE article, the type list of the UR Client Library, the version table of TestCommUR, and
reports. docs/protocols/rtde.md, section Releases, describes where they disagree. A client must not rely on the
releases: it has to ask the controller, which replies NOT_FOUND for variables that it does not have.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal, NamedTuple, cast

from linkcore.wire.fields import Coded, Float64b, Int8ub, Int32sb, Int32ub, Int64ub, Shape, Since

from .. import enums
from ..firmware import Firmware

#: Replies of a controller instead of a type: it does not have the variable, or another client holds the input.
NOT_FOUND, IN_USE = "NOT_FOUND", "IN_USE"

#: Types by the vendor's names. STRING also has a name, but no variable and no known size.
TYPES: Mapping[str, Shape] = MappingProxyType(
    {
        "BOOL": Coded(Int8ub, bool),
        "UINT8": Int8ub,
        "UINT32": Int32ub,
        "UINT64": Int64ub,
        "INT32": Int32sb,
        "DOUBLE": Float64b,
        "VECTOR3D": Float64b[3],
        "VECTOR6D": Float64b[6],
        "VECTOR6INT32": Int32sb[6],
        "VECTOR6UINT32": Int32ub[6],
    }
)

#: Evidence for the release of a variable: the vendor, public drivers, inferred from its neighbours, or none.
Evidence = Literal["vendor", "drivers", "inferred", "unverified"]


class Variable(NamedTuple):
    """RTDE variable.

    Attributes:
        name: Name by the vendor.
        type: Vendor's name of its type, a key of `TYPES`.
        unit: SI unit, or the kind of number.
        doc: Meaning of the variable.
        since: First release of each generation that has it; None if unknown.
        evidence: Evidence for `since`.
        meaning: Enum of its numbers, or another function that converts them.
    """

    name: str
    type: str
    unit: str
    doc: str
    since: Since | None
    evidence: Evidence
    meaning: Callable[[int], Any] | None = None

    def is_in(self, firmware: Firmware) -> bool:
        """Return whether a controller of this firmware has the variable. If unknown, 3.0 or later is assumed."""
        return firmware.major >= 3 if self.since is None else firmware in self.since


def shape_of(variable: Variable | None, type: str) -> Shape:
    """Return the shape of a variable with this type, as the controller reports it.

    The numbers are converted to their meaning if the table has the same type. None is an unknown variable.

    Raises:
        KeyError: If the type does not exist.
    """
    shape = TYPES[type]
    if variable is None or variable.meaning is None or type != variable.type:
        return shape
    number = shape.number
    assert number is not None, "every type has a fixed size"
    coded = Coded(number, variable.meaning)
    return coded if shape.count is None else coded[shape.count]


def _registers(direction: str, first: str, evidence: Evidence) -> Iterator[Variable]:
    """Yield the general-purpose registers of one direction: 128 bits, 48 integers and 48 doubles.

    The lower half is for fieldbuses and PLCs. The upper half, which was added later, is for RTDE clients.
    """
    whose = f"general-purpose {direction} register"
    for low, high in ((0, 31), (32, 63)):
        name = f"{direction}_bit_registers{low}_to_{high}"
        yield Variable(name, "UINT32", "bits", f"{whose}s, bits {low} to {high}", Since(first), evidence)
    for number in range(64, 128):
        # TestCommUR has UINT32 here. The UR Client Library, and the controllers of its tests, have BOOL.
        name = f"{direction}_bit_register_{number}"
        yield Variable(name, "BOOL", "", f"{whose}, bit {number}", Since("3.9/5.3"), "vendor")
    for kind, type in (("int", "INT32"), ("double", "DOUBLE")):
        for number in range(48):
            since = Since("3.4/5.0" if number < 24 else "3.9/5.3")
            yield Variable(f"{direction}_{kind}_register_{number}", type, "", f"{whose} {number}", since, "vendor")


def _read(direction: str) -> Iterator[Variable]:
    """Yield the variables of one direction in the table `variables.tsv`. Lines that begin with # are comments."""
    for line in Path(__file__).with_name("variables.tsv").read_text(encoding="utf-8").splitlines():
        if line.startswith(direction):
            _, name, type, unit, since, evidence, meaning, doc = line.split("\t")
            read_as = getattr(enums, meaning) if meaning else None
            yield Variable(name, type, unit, doc, Since(since) if since else None, cast(Evidence, evidence), read_as)


_INPUT_REGISTERS = tuple(_registers("input", "3.4/5.0", "vendor"))

#: Name -> output variable of a controller, including the input registers, which can be read back.
OUTPUTS: Mapping[str, Variable] = MappingProxyType(
    {each.name: each for each in (*_read("output"), *_registers("output", "3.3/5.0", "drivers"), *_INPUT_REGISTERS)}
)

#: Name -> input variable that a client can write.
INPUTS: Mapping[str, Variable] = MappingProxyType({each.name: each for each in (*_read("input"), *_INPUT_REGISTERS)})

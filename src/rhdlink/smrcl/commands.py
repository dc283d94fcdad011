"""The commands of the language: their names, and the parameters that they take.

How many parameters there are is checked by MRC, and what they are is not; here both are.
"""

from __future__ import annotations

from dataclasses import dataclass
from types import MappingProxyType

from .syntax import Operand, TextLiteral

__all__ = ["COMMANDS", "MOST_PARAMETERS", "MOTIONS", "Signature"]

#: A command that takes "up to 9" takes up to 49, as in MRC.
MOST_PARAMETERS = 49


@dataclass(frozen=True)
class Signature:
    """The parameters of a command.

    Attributes:
        least: how many there must be.
        most: how many there may be; 9 means `MOST_PARAMETERS`.
        kinds: of each: "d" a number, "s" a text, "x" either; the last one is that of all further ones.
    """

    least: int
    most: int
    kinds: str = ""

    def takes(self, count: int) -> bool:
        """Whether so many parameters will do."""
        return self.least <= count <= (MOST_PARAMETERS if self.most == 9 else self.most)

    def mistake(self, number: int, operand: Operand) -> str:
        """The error of a parameter, counted from 0; "" for none."""
        kind = self.kinds[min(number, len(self.kinds) - 1)]
        if kind == "s" and not isinstance(operand, TextLiteral):
            return f'parameter {number + 1} has to be a text, as in "name"'
        if kind == "d" and isinstance(operand, TextLiteral):
            return f"parameter {number + 1} has to be a number or a variable, not a text"
        return ""

    @property
    def count(self) -> str:
        """In words: how many."""
        if self.least == self.most:
            return f"{self.least} parameter{'s' * (self.least != 1)}"
        return f"{self.least} to {MOST_PARAMETERS if self.most == 9 else self.most} parameters"


#: Every command. "x" stands where MRC looks at whether there is a parameter, and not at what it is.
COMMANDS: MappingProxyType[str, Signature] = MappingProxyType(
    {
        "fwd": Signature(1, 1, "d"),
        "turn": Signature(1, 2, "dx"),
        "drive": Signature(0, 4, "dddx"),
        "driveon": Signature(0, 4, "dddx"),
        "drivew": Signature(3, 4, "dddx"),
        "driveonw": Signature(3, 4, "dddx"),
        "motorcmds": Signature(2, 2, "d"),
        "turnr": Signature(2, 3, "ddx"),
        "turnc": Signature(2, 3, "ddx"),
        "followline": Signature(1, 1, "s"),
        "followwall": Signature(2, 2, "sd"),
        "followwall2": Signature(2, 2, "sd"),
        "label": Signature(1, 1, "s"),
        "wait": Signature(1, 1, "d"),
        "goto": Signature(1, 1, "s"),
        "call": Signature(1, 1, "s"),
        "return": Signature(0, 0),
        "log": Signature(1, 9, "s"),
        "stream": Signature(1, 9, "ds"),
        "stop": Signature(0, 0),
        "idle": Signature(0, 0),
        "resetmotors": Signature(0, 0),
        "barcode": Signature(0, 0),
        "get": Signature(1, 2, "s"),
        "set": Signature(2, 2, "sd"),
        "setoutput": Signature(2, 2, "sd"),
        "setoffset": Signature(2, 2, "sd"),
        "setgain": Signature(2, 2, "sd"),
        "setpar": Signature(4, 4, "sssd"),
        "routeinput": Signature(4, 4, "s"),
        "routeoutput": Signature(2, 2, "s"),
        "control": Signature(1, 3, "s"),
        "open": Signature(1, 1, "s"),
        "writewifi": Signature(3, 3, "sdd"),
        "play": Signature(1, 1, "s"),
        "speak": Signature(1, 1, "s"),
        "print": Signature(1, 1, "s"),
        "read": Signature(1, 1, "s"),
        "wallest": Signature(2, 4, "sd"),
        "align": Signature(0, 0),
        "ignoreobstacles": Signature(0, 0),
        "vision": Signature(1, 1, "s"),
        "laser": Signature(1, 1, "s"),
        "putevent": Signature(1, 1, "s"),
        "syncevent": Signature(1, 1, "s"),
        "targethere": Signature(0, 0),
        "resetodocov": Signature(0, 0),
        "addwatch": Signature(2, 2, "sd"),
        "array": Signature(2, 2, "sd"),
        "trans": Signature(6, 6, "d"),
        "invtrans": Signature(6, 6, "d"),
        "stringcat": Signature(1, 9, "x"),
        "tointstring": Signature(1, 1, "d"),
        "drivetopoint": Signature(4, 5, "ddddx"),
        "movetoxyz": Signature(3, 3, "d"),
        "funcgen": Signature(1, 5, "d"),
    }
)

#: Those that move the robot.
MOTIONS = frozenset(
    (
        *("fwd", "turn", "turnr", "turnc", "drive", "driveon", "drivew", "driveonw", "drivetopoint"),
        *("followline", "followwall", "followwall2", "motorcmds", "align", "stop", "idle", "movetoxyz"),
    )
)

"""Table of the commands of the language. Each command has one row, with its parameters and its function.

MRC checks the number of parameters, but not their kinds. This module checks both, before a script runs and when a line
is executed. To add a command, write a function, a row below, and a row of the page on SMR-CL.
"""

from __future__ import annotations

import enum
import inspect
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

from . import driving, effects, settings
from .arithmetic import format_number
from .parser import FUNCTIONS, KEYWORDS
from .plan import Outcome
from .syntax import CommandStatement, TextLiteral

#: Maximum number of parameters of a command whose last one can be repeated, as in MRC, which calls it "up to 9".
MOST_PARAMETERS = 49
#: Largest accepted length in m, or angle in rad or degrees.
_FARTHEST = 1e6


class ParameterKind(enum.Enum):
    """Kind of a parameter."""

    NUMBER = "a number"
    #: m, rad or degrees; at most `_FARTHEST` if the profile checks numbers.
    LENGTH = "a length or an angle"
    TEXT = "a text"
    #: A text that names a label of the script.
    LABEL = "a label"
    #: A text that names the variable that the command makes.
    NEW_NAME = "a new name"
    #: MRC checks only whether the parameter exists, not its value.
    ANY = "anything"


_ANY, _LENGTH, _NUMBER, _TEXT = ParameterKind.ANY, ParameterKind.LENGTH, ParameterKind.NUMBER, ParameterKind.TEXT
_TEXTS = frozenset((_TEXT, ParameterKind.LABEL, ParameterKind.NEW_NAME))
_NUMBERS = frozenset((_NUMBER, _LENGTH))


@dataclass(frozen=True)
class ScriptCommand:
    """Row of the table of commands.

    Attributes:
        name: Name of the command.
        execute: Function that executes the command. It is called with a `MissionEffects` and the parameters, each a
            float or a str.
        kinds: Kinds of the parameters.
        optional: Number of parameters at the end that can be omitted.
        repeats: Whether the last parameter can be repeated.
        needs_condition: Example of the command with the stop condition that it needs; "" if it needs none.
        hook: Text that MRC prints if the hardware is missing. A function of the user can execute such a command; see
            `Mission.on`. None if no function can execute the command.

    Raises:
        TypeError: If the function does not accept these parameters.
    """

    name: str
    execute: Callable[..., Outcome]
    kinds: tuple[ParameterKind, ...] = ()
    optional: int = 0
    repeats: bool = False
    needs_condition: str = ""
    hook: str | None = None

    def __post_init__(self) -> None:
        signature = inspect.signature(self.execute)
        for count in (self.least, self.most):
            try:
                signature.bind(None, *range(count))
            except TypeError as error:
                raise TypeError(f"{self.name} takes {self.count}, but its function does not: {error}") from None

    @property
    def least(self) -> int:
        """Minimum number of parameters."""
        return len(self.kinds) - self.optional

    @property
    def most(self) -> int:
        """Maximum number of parameters."""
        return MOST_PARAMETERS if self.repeats else len(self.kinds)

    def takes(self, count: int) -> bool:
        """Whether this number of parameters is allowed."""
        return self.least <= count <= self.most

    @property
    def count(self) -> str:
        """Number of parameters, in words."""
        if self.least == self.most:
            return f"{self.least} parameter{'s' * (self.least != 1)}"
        return f"{self.least} to {self.most} parameters"

    def kind(self, number: int) -> ParameterKind:
        """Return the kind of a parameter, counted from 0. Additional parameters have the kind of the last parameter."""
        return self.kinds[min(number, len(self.kinds) - 1)] if self.kinds else ParameterKind.ANY

    def mistakes(self, statement: CommandStatement, values: Sequence[object], *, checks_numbers: bool) -> Iterator[str]:
        """Yield the errors of a statement with this command.

        Args:
            statement: Parsed statement.
            values: Values of its parameters, each a float or a str; None for a value that is not known yet.
            checks_numbers: Whether a number that is too large for a motion is an error.
        """
        if not self.takes(len(values)):
            yield f"{self.name} takes {self.count}, not {len(values)}"
            return
        for number, (operand, value) in enumerate(zip(statement.parameters, values, strict=True)):
            kind, has_to_be = self.kind(number), f"{self.name}: parameter {number + 1} has to be"
            if kind in _TEXTS and not isinstance(operand, TextLiteral):
                yield f'{has_to_be} a text, as in "name"'
            elif kind in _NUMBERS and isinstance(operand, TextLiteral):
                yield f"{has_to_be} a number or a variable, not a text"
            elif checks_numbers and kind is _LENGTH and isinstance(value, float) and not abs(value) <= _FARTHEST:
                yield f"{has_to_be} {kind.value} of at most {_FARTHEST:g}, not {format_number(value)}"
        if self.needs_condition and not statement.conditions:
            yield f"{self.name} needs a condition, as in {self.needs_condition}"


_REFERENCE = (_LENGTH, _LENGTH, _LENGTH, _ANY)

_TABLE = (
    # -- motions
    ScriptCommand("fwd", driving.forward, (_LENGTH,)),
    ScriptCommand("turn", driving.turn, (_LENGTH, _ANY), optional=1),
    ScriptCommand("turnr", driving.turn_on_arc, (_LENGTH, _LENGTH, _ANY), optional=1),
    ScriptCommand("turnc", driving.turn_on_clothoid, (_LENGTH, _LENGTH, _ANY), optional=1),
    ScriptCommand("drive", driving.drive, _REFERENCE, optional=4),
    ScriptCommand("driveon", driving.drive_on, _REFERENCE, optional=4),
    ScriptCommand("drivew", driving.drive_in_world, _REFERENCE, optional=1),
    ScriptCommand("driveonw", driving.drive_on_in_world, _REFERENCE, optional=1),
    ScriptCommand("drivetopoint", driving.drive_to_point, (_LENGTH, _LENGTH, _LENGTH, _LENGTH, _ANY), optional=1),
    ScriptCommand("motorcmds", driving.set_wheels, (_LENGTH, _LENGTH)),
    ScriptCommand("followline", driving.follow_line, (_TEXT,)),
    ScriptCommand("followwall", driving.follow_wall, (_TEXT, _LENGTH)),
    ScriptCommand("followwall2", driving.follow_wall_by_table, (_TEXT, _LENGTH)),
    ScriptCommand("stop", driving.stop),
    ScriptCommand("idle", driving.idle),
    ScriptCommand("align", driving.align),
    ScriptCommand("movetoxyz", driving.move_to, (_NUMBER, _NUMBER, _NUMBER), hook=""),
    ScriptCommand("funcgen", driving.generate, (_LENGTH,) * 5, optional=4),
    ScriptCommand("ignoreobstacles", driving.ignore_obstacles),
    ScriptCommand("targethere", driving.set_target_here),
    ScriptCommand("resetodocov", driving.reset_covariance),
    ScriptCommand("resetmotors", driving.reset_motors),
    # -- flow
    ScriptCommand("label", effects.pass_label, (_TEXT,)),
    ScriptCommand("goto", effects.go_to, (ParameterKind.LABEL,)),
    ScriptCommand("call", effects.call, (ParameterKind.LABEL,)),
    ScriptCommand("return", effects.go_back),
    ScriptCommand("wait", effects.wait, (_NUMBER,)),
    # -- variables and settings
    ScriptCommand("array", settings.make_array, (ParameterKind.NEW_NAME, _NUMBER)),
    ScriptCommand("trans", settings.transform, (_NUMBER,) * 6),
    ScriptCommand("invtrans", settings.transform_back, (_NUMBER,) * 6),
    ScriptCommand("set", settings.set_value, (_TEXT, _NUMBER)),
    ScriptCommand("setoutput", settings.set_output, (_TEXT, _NUMBER)),
    ScriptCommand("setoffset", settings.set_offset, (_TEXT, _NUMBER)),
    ScriptCommand("setgain", settings.set_gain, (_TEXT, _NUMBER)),
    ScriptCommand("setpar", settings.set_parameter, (_TEXT, _TEXT, _TEXT, _NUMBER)),
    ScriptCommand("routeinput", settings.route_input, (_TEXT,) * 4),
    ScriptCommand("routeoutput", settings.route_output, (_TEXT, _TEXT)),
    # -- log, streams, watches, events, texts
    ScriptCommand("log", effects.log, (_TEXT,), repeats=True),
    ScriptCommand("control", effects.control_log, (_TEXT, _TEXT, _TEXT), optional=2),
    ScriptCommand("stream", effects.stream, (_NUMBER, _TEXT), optional=1, repeats=True),
    ScriptCommand("addwatch", effects.add_watch, (_TEXT, _NUMBER), needs_condition='addwatch "name" 1 : ($odox > 1)'),
    ScriptCommand("putevent", effects.put_event, (_TEXT,)),
    ScriptCommand("syncevent", effects.sync_event, (_TEXT,)),
    ScriptCommand("print", effects.print_text, (_TEXT,)),
    ScriptCommand("read", effects.read, (_TEXT,), hook=""),
    ScriptCommand("stringcat", effects.join_texts, (_ANY,), repeats=True),
    ScriptCommand("tointstring", effects.write_whole, (_NUMBER,)),
    # -- special hardware
    ScriptCommand("vision", effects.ask_of_text, (_TEXT,), hook="Not connected to cameraserver \n"),
    ScriptCommand("laser", effects.ask_of_text, (_TEXT,), hook="No connection to laserserver \n"),
    ScriptCommand("get", effects.get, (_TEXT, _TEXT), optional=1, hook=""),
    ScriptCommand("play", effects.ask, (_TEXT,), hook=""),
    ScriptCommand("speak", effects.ask_of_text, (_TEXT,), hook='/usr/local/bin/flite -t "{}"'),
    ScriptCommand("open", effects.ask, (_TEXT,), hook="open {} \n"),
    ScriptCommand("writewifi", effects.ask, (_TEXT, _NUMBER, _NUMBER), hook=""),
    ScriptCommand("wallest", effects.estimate_wall, (_TEXT, _NUMBER, _NUMBER, _NUMBER), optional=2, hook=""),
    ScriptCommand("barcode", effects.ask, hook=""),
)

#: Every command, by name.
COMMANDS: Mapping[str, ScriptCommand] = {command.name: command for command in _TABLE}

#: Names that neither a variable nor a function of a mission can have.
RESERVED = KEYWORDS | COMMANDS.keys() | FUNCTIONS.keys()

"""The syntax tree of SMR-CL.

A tree says what is written and nothing of what it means to a robot: whether a variable exists is found out when the
line is executed, as in MRC. Columns do not count when trees are compared.
"""

from __future__ import annotations

from dataclasses import dataclass, field

#: How tightly a binary operator binds; a level for almost each of them, as in MRC's grammar. Equal ones group to the
#: left, ``^`` to the right.
PRECEDENCE = {
    "|": 1,
    "&": 2,
    "==": 3,
    "!=": 4,
    ">": 5,
    "<": 6,
    ">=": 7,
    "<=": 8,
    "+": 9,
    "-": 9,
    "*": 10,
    "/": 10,
    "^": 12,
}
#: Of the unary minus: ``-2^2`` is -4 and ``-2*3`` is ``(-2)*3``.
UNARY_PRECEDENCE = 11


@dataclass(frozen=True)
class NumberLiteral:
    """A number, without a sign except as a parameter of a command."""

    value: float


@dataclass(frozen=True)
class TextLiteral:
    """A string, as a parameter of a command."""

    value: str


@dataclass(frozen=True)
class VariableName:
    """A variable of the script, or with `is_system` one of the robot (``$name``)."""

    name: str
    is_system: bool = False
    column: int = field(default=0, compare=False)


@dataclass(frozen=True)
class ArrayElement:
    """One value of an array."""

    array: VariableName
    index: Expression


@dataclass(frozen=True)
class Call:
    """A function with its arguments."""

    name: str
    arguments: tuple[Expression, ...]
    column: int = field(default=0, compare=False)


@dataclass(frozen=True)
class Negate:
    """The unary minus."""

    operand: Expression


@dataclass(frozen=True)
class Binary:
    """Two expressions and an operator of `PRECEDENCE`."""

    operator: str
    left: Expression
    right: Expression


Expression = NumberLiteral | VariableName | ArrayElement | Call | Negate | Binary
Operand = NumberLiteral | TextLiteral | VariableName


@dataclass(frozen=True)
class SpeedSetting:
    """``@v`` or ``@a`` with its value.

    Attributes:
        letter: "v" for the speed, m/s, or "a" for the acceleration, m/s2.
    """

    letter: str
    value: NumberLiteral | VariableName


@dataclass(frozen=True)
class CommandStatement:
    """A command with its parameters, speeds and stop conditions.

    Attributes:
        is_broken: what follows on the line is an error. The speeds are set, and then the line fails.
    """

    name: str
    parameters: tuple[Operand, ...] = ()
    speeds: tuple[SpeedSetting, ...] = ()
    conditions: tuple[Expression, ...] = ()
    column: int = field(default=0, compare=False)
    is_broken: bool = False


@dataclass(frozen=True)
class WaitFor:
    """``: (condition) | (condition)``.

    Without conditions: how MRC reads a line that begins with a character beyond ASCII. Its column is `column`.
    """

    conditions: tuple[Expression, ...]
    column: int = field(default=0, compare=False)


@dataclass(frozen=True)
class Evaluate:
    """``eval``."""

    values: tuple[Expression, ...]


@dataclass(frozen=True)
class If:
    """Jump to a label if the condition is not 0.

    Attributes:
        column: of the label.
    """

    condition: Expression
    label: str
    column: int = field(default=0, compare=False)


@dataclass(frozen=True)
class Assign:
    """An assignment.

    Attributes:
        following: the name of a variable of the script that comes right behind it, where one does. MRC reads it before
            it makes a new variable, and then makes the wrong one; `MRC`'s profile does likewise.
    """

    target: VariableName | ArrayElement
    value: Expression
    following: str | None = field(default=None, compare=False)


@dataclass(frozen=True)
class Switch:
    """``switch``: the lines up to the matching `Case` are skipped."""

    value: Expression


@dataclass(frozen=True)
class Case:
    """``case``, where it is not skipped: the lines up to the next matching case or `EndSwitch` are skipped."""

    value: NumberLiteral


@dataclass(frozen=True)
class EndSwitch:
    """``endswitch``."""


Statement = CommandStatement | WaitFor | Evaluate | If | Assign | Switch | Case | EndSwitch


@dataclass(frozen=True)
class Problem:
    """What is wrong with a line.

    Attributes:
        column: where, from 1.
        message: what was found, and what was expected.
    """

    column: int
    message: str


@dataclass(frozen=True)
class ScriptLine:
    """A line: what it says up to the first problem, and that problem.

    Attributes:
        statements: in order. Only assignments can be followed by others.
        problem: None if all of the line is understood.
    """

    statements: tuple[Statement, ...]
    problem: Problem | None = None

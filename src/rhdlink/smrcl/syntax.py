"""Syntax tree of SMR-CL.

A tree represents the text, but not its meaning for a robot. Whether a variable exists is checked when the line is
executed, as in MRC. Columns are ignored when trees are compared.
"""

from __future__ import annotations

from dataclasses import dataclass, field

#: Precedence of the binary operators. As in MRC's grammar, almost every operator has its own level. Operators of the
#: same level group to the left, and ``^`` groups to the right.
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
#: Precedence of the unary minus: ``-2^2`` is -4 and ``-2*3`` is ``(-2)*3``.
UNARY_PRECEDENCE = 11


@dataclass(frozen=True)
class NumberLiteral:
    """Number. It has a sign only if it is a parameter of a command."""

    value: float


@dataclass(frozen=True)
class TextLiteral:
    """String that is a parameter of a command."""

    value: str


@dataclass(frozen=True)
class VariableName:
    """Variable of the script, or system variable (``$name``) if `is_system`."""

    name: str
    is_system: bool = False
    column: int = field(default=0, compare=False)


@dataclass(frozen=True)
class ArrayElement:
    """Element of an array."""

    array: VariableName
    index: Expression


@dataclass(frozen=True)
class Call:
    """Call of a function, with its arguments."""

    name: str
    arguments: tuple[Expression, ...]
    column: int = field(default=0, compare=False)


@dataclass(frozen=True)
class Negate:
    """Unary minus, with its operand."""

    operand: Expression


@dataclass(frozen=True)
class Binary:
    """Binary operation: two expressions, and an operator in `PRECEDENCE`."""

    operator: str
    left: Expression
    right: Expression


Expression = NumberLiteral | VariableName | ArrayElement | Call | Negate | Binary
Operand = NumberLiteral | TextLiteral | VariableName


@dataclass(frozen=True)
class SpeedSetting:
    """Setting of speed or acceleration: ``@v`` or ``@a`` with its value.

    Attributes:
        letter: "v" for the speed in m/s, or "a" for the acceleration in m/s2.
    """

    letter: str
    value: NumberLiteral | VariableName


@dataclass(frozen=True)
class CommandStatement:
    """Command with its parameters, speeds and stop conditions.

    Attributes:
        is_broken: Whether an error follows on the line. The speeds are set, and then the line fails.
    """

    name: str
    parameters: tuple[Operand, ...] = ()
    speeds: tuple[SpeedSetting, ...] = ()
    conditions: tuple[Expression, ...] = ()
    column: int = field(default=0, compare=False)
    is_broken: bool = False


@dataclass(frozen=True)
class WaitFor:
    """Line that only waits for conditions: ``: (condition) | (condition)``.

    Without conditions, the object represents a line that begins with a character beyond ASCII, as MRC reads such a
    line. `column` is the column of the character.
    """

    conditions: tuple[Expression, ...]
    column: int = field(default=0, compare=False)


@dataclass(frozen=True)
class Evaluate:
    """Statement ``eval`` with its expressions."""

    values: tuple[Expression, ...]


@dataclass(frozen=True)
class If:
    """Statement ``if``: jump to a label if the condition is not 0.

    Attributes:
        column: Column of the label.
    """

    condition: Expression
    label: str
    column: int = field(default=0, compare=False)


@dataclass(frozen=True)
class Assign:
    """Assignment to a variable or to an element of an array.

    Attributes:
        following: Name of a script variable that follows immediately on the line, if there is one. MRC reads this name
            before it makes a new variable, and then makes the wrong variable. `MRC`'s profile does the same.
    """

    target: VariableName | ArrayElement
    value: Expression
    following: str | None = field(default=None, compare=False)


@dataclass(frozen=True)
class Switch:
    """Statement ``switch``: the lines up to the matching `Case` are skipped."""

    value: Expression


@dataclass(frozen=True)
class Case:
    """Statement ``case`` that is not skipped.

    The lines up to the next matching case or `EndSwitch` are skipped.
    """

    value: NumberLiteral


@dataclass(frozen=True)
class EndSwitch:
    """Statement ``endswitch``."""


Statement = CommandStatement | WaitFor | Evaluate | If | Assign | Switch | Case | EndSwitch


@dataclass(frozen=True)
class Problem:
    """Error in a line.

    Attributes:
        column: Column of the error, counted from 1.
        message: Description of the text that was found, and of the text that was expected.
    """

    column: int
    message: str


@dataclass(frozen=True)
class ScriptLine:
    """Parsed line: its statements up to the first problem, and this problem.

    Attributes:
        statements: Statements, in order. Only assignments can be followed by other statements.
        problem: First problem; None if the whole line is valid.
    """

    statements: tuple[Statement, ...]
    problem: Problem | None = None

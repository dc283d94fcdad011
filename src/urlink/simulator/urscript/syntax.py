"""Syntax tree of a program, which consists of expressions and statements. Each has its place in the text."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

Scope = Literal["global", "local", "free"]


@dataclass(slots=True)
class Node:
    """Part of a program.

    Attributes:
        place: Character offset in the text. For an operation, it is the offset of the operator.
    """

    place: int


@dataclass(slots=True)
class Expression(Node):
    """Expression.

    Attributes:
        depth: Nesting depth; 1 if there are no subexpressions.
        has_calls: Whether the expression contains a call.
    """

    depth: int
    has_calls: bool


@dataclass(slots=True)
class Constant(Expression):
    """Constant: a number, a string or a truth value."""

    value: float | int | bool | str


@dataclass(slots=True)
class Name(Expression):
    """Value of a variable."""

    name: str


@dataclass(slots=True)
class ListDisplay(Expression):
    """List: `[a, b]`."""

    items: list[Expression]


@dataclass(slots=True)
class PoseDisplay(Expression):
    """Pose: `p[a, b, c, d, e, f]`."""

    items: list[Expression]


@dataclass(slots=True)
class Index(Expression):
    """Element of a value: `base[index]`."""

    base: Expression
    index: Expression


@dataclass(slots=True)
class Member(Expression):
    """Member of a struct: `base.name`."""

    base: Expression
    name: str


@dataclass(slots=True)
class Unary(Expression):
    """Operation with one operand: `-a`, `+a` or `not a`."""

    operator: str
    operand: Expression


@dataclass(slots=True)
class Binary(Expression):
    """Operation with two operands: arithmetic, comparison, `and`, `or`, or `xor`."""

    operator: str
    left: Expression
    right: Expression


@dataclass(slots=True)
class Call(Expression):
    """Call of a function: `f(a, b=c)`; or `run f(a)`, which starts a thread and returns its handle."""

    name: str
    arguments: list[Expression]
    named: list[tuple[str, Expression]]
    is_run: bool


@dataclass(slots=True)
class MethodCall(Expression):
    """Call of a remote method: `handle.name(a)`."""

    base: Expression
    name: str
    arguments: list[Expression]


@dataclass(slots=True)
class Statement(Node):
    """Statement."""


Block = list[Statement]


@dataclass(slots=True)
class Declare(Statement):
    """Declaration without a value: `global a` or `local a`."""

    name: str
    scope: Scope


@dataclass(slots=True)
class Assign(Statement):
    """Assignment: `a = value`, `local a = value`, or `a[i].b = value`.

    The name of a member is a constant of type `MemberName`.
    """

    name: str
    scope: Scope
    indices: list[Expression]
    value: Expression


@dataclass(slots=True)
class Evaluate(Statement):
    """Expression that is used as a statement, such as a call, or `enter_critical`."""

    value: Expression


@dataclass(slots=True)
class If(Statement):
    """`if` statement with all its `elif` branches and the `else` branch, which may be empty."""

    branches: list[tuple[Expression, Block]]
    otherwise: Block


@dataclass(slots=True)
class While(Statement):
    """`while` loop."""

    condition: Expression
    body: Block


@dataclass(slots=True)
class Return(Statement):
    """`return`, with or without a value."""

    value: Expression | None


@dataclass(slots=True)
class Break(Statement):
    """`break` statement."""


@dataclass(slots=True)
class Continue(Statement):
    """`continue` statement."""


@dataclass(slots=True)
class Halt(Statement):
    """`halt` statement."""


@dataclass(slots=True)
class Kill(Statement):
    """`kill handle`, which ends a thread."""

    handle: Expression


@dataclass(slots=True)
class Join(Statement):
    """`join handle`, which waits until a thread has ended."""

    handle: Expression


@dataclass(slots=True)
class NodeLabel(Statement):
    """Beginning of a program node of PolyScope: `$ 3 "home" "breakAfter"`.

    `jump_to_label` can jump to a node.
    """

    number: int
    name: str


@dataclass(slots=True)
class FunctionParameter(Node):
    """Parameter of a function; `default` is None if there is no default value."""

    name: str
    default: Expression | None


@dataclass(slots=True)
class Definition(Statement):
    """Definition of a function, a program or a thread: `def`, `sec` or `thread`."""

    kind: Literal["def", "sec", "thread"]
    name: str
    parameters: list[FunctionParameter]
    body: Block


def parts_of(node: Expression) -> Sequence[Expression]:
    """Return the direct subexpressions of an expression."""
    match node:
        case ListDisplay() | PoseDisplay():
            return node.items
        case Index():
            return (node.base, node.index)
        case Member():
            return (node.base,)
        case MethodCall():
            return (node.base, *node.arguments)
        case Unary():
            return (node.operand,)
        case Binary():
            return (node.left, node.right)
        case Call():
            return [*node.arguments, *(value for _, value in node.named)]
        case _:
            return ()

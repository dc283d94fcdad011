"""The syntax tree of a program: expressions and statements, each with its place in the text."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

Scope = Literal["global", "local", "free"]


@dataclass(slots=True)
class Node:
    """A part of a program.

    Attributes:
        place: Character offset in the text. For an operation, it is the offset of the operator.
    """

    place: int


@dataclass(slots=True)
class Expression(Node):
    """An expression.

    Attributes:
        depth: Nesting depth; 1 without subexpressions.
        has_calls: Whether the expression contains a call.
    """

    depth: int
    has_calls: bool


@dataclass(slots=True)
class Constant(Expression):
    """A number, string or truth value."""

    value: float | int | bool | str


@dataclass(slots=True)
class Name(Expression):
    """The value of a variable."""

    name: str


@dataclass(slots=True)
class ListDisplay(Expression):
    """`[a, b]`"""

    items: list[Expression]


@dataclass(slots=True)
class PoseDisplay(Expression):
    """`p[a, b, c, d, e, f]`"""

    items: list[Expression]


@dataclass(slots=True)
class Index(Expression):
    """`base[index]`"""

    base: Expression
    index: Expression


@dataclass(slots=True)
class Member(Expression):
    """`base.name` of a struct"""

    base: Expression
    name: str


@dataclass(slots=True)
class Unary(Expression):
    """`-a` or `not a`"""

    operator: str
    operand: Expression


@dataclass(slots=True)
class Binary(Expression):
    """Arithmetic, comparison, and `and`, `or`, `xor`."""

    operator: str
    left: Expression
    right: Expression


@dataclass(slots=True)
class Call(Expression):
    """`f(a, b=c)`, or `run f(a)`, whose value is the handle of a thread."""

    name: str
    arguments: list[Expression]
    named: list[tuple[str, Expression]]
    is_run: bool


@dataclass(slots=True)
class MethodCall(Expression):
    """`handle.name(a)`"""

    base: Expression
    name: str
    arguments: list[Expression]


@dataclass(slots=True)
class Statement(Node):
    """A statement."""


Block = list[Statement]


@dataclass(slots=True)
class Declare(Statement):
    """`global a` or `local a`, without a value."""

    name: str
    scope: Scope


@dataclass(slots=True)
class Assign(Statement):
    """`a = value`, `local a = value`, or `a[i].b = value`; a member's name is a constant `MemberName`."""

    name: str
    scope: Scope
    indices: list[Expression]
    value: Expression


@dataclass(slots=True)
class Evaluate(Statement):
    """An expression as a statement: a call, or `enter_critical`."""

    value: Expression


@dataclass(slots=True)
class If(Statement):
    """`if`, every `elif`, and `else`, which may be empty."""

    branches: list[tuple[Expression, Block]]
    otherwise: Block


@dataclass(slots=True)
class While(Statement):
    """`while`"""

    condition: Expression
    body: Block


@dataclass(slots=True)
class Return(Statement):
    """`return`, with a value or without."""

    value: Expression | None


@dataclass(slots=True)
class Break(Statement):
    """`break`"""


@dataclass(slots=True)
class Continue(Statement):
    """`continue`"""


@dataclass(slots=True)
class Halt(Statement):
    """`halt`"""


@dataclass(slots=True)
class Kill(Statement):
    """`kill handle`"""

    handle: Expression


@dataclass(slots=True)
class Join(Statement):
    """`join handle`"""

    handle: Expression


@dataclass(slots=True)
class NodeLabel(Statement):
    """`$ 3 "home" "breakAfter"`: the beginning of a program node of PolyScope.

    It is a target of `jump_to_label`.
    """

    number: int
    name: str


@dataclass(slots=True)
class FunctionParameter(Node):
    """A parameter of a function; `default` is None without a default."""

    name: str
    default: Expression | None


@dataclass(slots=True)
class Definition(Statement):
    """`def`, `sec` or `thread`."""

    kind: Literal["def", "sec", "thread"]
    name: str
    parameters: list[FunctionParameter]
    body: Block


def parts_of(node: Expression) -> Sequence[Expression]:
    """Return the direct subexpressions."""
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

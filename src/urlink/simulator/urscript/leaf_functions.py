"""Functions of a program that only work something out, such as a number within bounds.

They hold conditions and values to return, and neither call nor assign anything nor loop. So a call of one takes no turn
from other threads and always comes to its end, and is a part of the expression that it stands in rather than an
instruction with a frame to come back to.
"""

from __future__ import annotations

from collections.abc import Container

from .syntax import (
    Binary,
    Constant,
    Definition,
    If,
    Index,
    ListDisplay,
    Name,
    Node,
    PoseDisplay,
    Return,
    Unary,
    parts_of,
)

__all__ = ["leaf_size"]

#: Parts of the largest: a call of it is as cheap as a long expression.
_LARGEST = 64


def leaf_size(definition: Definition, names: Container[str]) -> int:
    """How many parts such a function has; 0 for any other.

    Args:
        definition: of the function.
        names: of the program's global variables.
    """
    parameters = {parameter.name for parameter in definition.parameters}
    has_defaults = any(parameter.default is not None for parameter in definition.parameters)
    if definition.kind != "def" or has_defaults or len(parameters) < len(definition.parameters):
        return 0
    size = 1
    waiting: list[Node] = [*definition.body]
    while waiting:
        node = waiting.pop()
        size += 1
        if size > _LARGEST:
            return 0
        match node:
            case If():
                for condition, block in node.branches:
                    waiting += [condition, *block]
                waiting += node.otherwise
            case Return():
                waiting += [] if node.value is None else [node.value]
            case Name():
                if node.name not in parameters and node.name not in names:
                    return 0
            case Constant():
                pass
            case Index() | Unary() | Binary() | ListDisplay() | PoseDisplay():
                waiting += parts_of(node)
            case _:
                return 0
    return size

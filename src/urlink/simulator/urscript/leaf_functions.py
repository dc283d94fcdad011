"""Leaf functions of a program: those that only compute a value, such as a number limited to a range.

They consist of conditions and return values, without calls, assignments or loops. So a call of one cannot delay other
threads and always terminates. It is a part of its expression rather than an instruction with a frame to return to.
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
    NodeLabel,
    PoseDisplay,
    Return,
    Unary,
    parts_of,
)

__all__ = ["leaf_size"]

#: Most parts of a leaf function: a call is as cheap as a long expression.
_LARGEST = 64


def leaf_size(definition: Definition, names: Container[str]) -> int:
    """Number of parts of a leaf function; 0 for any other function.

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
            case Constant() | NodeLabel():
                pass
            case Index() | Unary() | Binary() | ListDisplay() | PoseDisplay():
                waiting += parts_of(node)
            case _:
                return 0
    return size

"""Scopes of the names in a program, and recognition of leaf functions.

The manuals (cited from memory) define `global` and `local`. A name that is declared neither `global` nor `local` refers
to the global variable with this name, if there is one. Otherwise it is local to its function. The following is assumed:

- An assignment in the program itself, outside of nested functions, assigns to a global variable unless it uses `local`.
  So nested functions and threads can use the variable.
- The scope of a name is the same in the whole text, and does not depend on the order of execution.
- A function cannot use the local variables of the enclosing function.
- A function can be called in the enclosing function and in all functions that are nested there, even before its
  definition.

A leaf function only computes a value, such as a number that is limited to a range. It consists of conditions and return
values, without calls, assignments or loops. So a call of a leaf function always terminates, and cannot delay other
threads. Such a call is compiled as a part of its expression, not as an instruction that enters a function and returns
later.
"""

from __future__ import annotations

from collections import ChainMap
from collections.abc import Container
from dataclasses import dataclass, field

from .machine import Code
from .syntax import (
    Assign,
    Binary,
    Block,
    Constant,
    Declare,
    Definition,
    Evaluate,
    If,
    Index,
    ListDisplay,
    Name,
    Node,
    NodeLabel,
    PoseDisplay,
    Return,
    Unary,
    While,
    parts_of,
)


@dataclass
class Names:
    """Names that occur in the body of a function, without the names in nested functions.

    Attributes:
        local: Names that are declared `local`.
        global_: Names that are declared `global`.
        free: Names that are assigned without a declaration. An assignment to an element creates no variable.
        definitions: Nested functions.
    """

    local: dict[str, None] = field(default_factory=dict)
    global_: dict[str, None] = field(default_factory=dict)
    free: dict[str, None] = field(default_factory=dict)
    definitions: list[Definition] = field(default_factory=list)

    @classmethod
    def of(cls, body: Block) -> Names:
        """Return the names in the body of a function. Each statement is visited once."""
        names = cls()
        blocks = [body]
        while blocks:
            for statement in blocks.pop():
                if isinstance(statement, Evaluate):
                    continue
                if isinstance(statement, (Assign, Declare)):
                    if statement.scope == "local":
                        names.local[statement.name] = None
                    elif statement.scope == "global":
                        names.global_[statement.name] = None
                    elif isinstance(statement, Assign) and not statement.indices:
                        names.free[statement.name] = None
                elif isinstance(statement, Definition):
                    names.definitions.append(statement)
                elif isinstance(statement, If):
                    blocks += [block for _, block in statement.branches]
                    blocks.append(statement.otherwise)
                elif isinstance(statement, While):
                    blocks.append(statement.body)
        return names


#: Functions and threads that can be used in a scope. The innermost scope comes first.
Functions = ChainMap[str, tuple[Definition, Code]]


def global_names(body: Block) -> list[str]:
    """Return the names of a program's global variables.

    Names that the program itself assigns come before names in nested functions.
    """
    names = Names.of(body)
    found = dict.fromkeys(sorted(names.free.keys() - names.local.keys()))
    found |= names.global_
    waiting = names.definitions
    while waiting:
        inner = Names.of(waiting.pop().body)
        found |= inner.global_
        waiting += inner.definitions
    return list(found)


#: Maximum number of parts of a leaf function. It ensures that a call costs no more than a long expression.
_LARGEST = 64


def leaf_size(definition: Definition, names: Container[str]) -> int:
    """Return the number of parts of a leaf function; 0 if the function is not a leaf function.

    Args:
        definition: Definition of the function.
        names: Names of the program's global variables.
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

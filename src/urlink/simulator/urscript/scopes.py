"""Which variable a name means.

What the manuals say, as far as it is remembered: `global` and `local` settle it; a name with neither is the global of
that name if there is one, and otherwise local to its function. What is assumed beyond that:

- what the program's own body assigns without `local` is global, so that nested functions and threads see it;
- it is settled for the whole text at once, whatever the order in which the program gets there;
- a function does not see the local variables of the function it stands in;
- functions are known in the function they stand in and in all that stands there, before they are defined too.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from .code import Code
from .syntax import Assign, Block, Declare, Definition, If, Statement, While

__all__ = ["Functions", "assigned", "declared_local", "definitions", "global_names"]


class Functions:
    """The functions and threads that are known somewhere in a program."""

    def __init__(self, definitions: Sequence[Definition], outer: Functions | None) -> None:
        self._outer = outer
        self._known = {definition.name: (definition, Code(definition.name)) for definition in definitions}

    def find(self, name: str) -> tuple[Definition, Code] | None:
        """The one of that name, the innermost if there are several."""
        scope: Functions | None = self
        while scope is not None:
            if name in scope._known:
                return scope._known[name]
            scope = scope._outer
        return None


def _flat(block: Block) -> Iterator[Statement]:
    """All statements of a function, those in loops and branches too; of nested functions only the definition."""
    for statement in block:
        yield statement
        if isinstance(statement, If):
            for _, body in statement.branches:
                yield from _flat(body)
            yield from _flat(statement.otherwise)
        elif isinstance(statement, While):
            yield from _flat(statement.body)


def definitions(block: Block) -> list[Definition]:
    """The functions that stand in a function."""
    return [statement for statement in _flat(block) if isinstance(statement, Definition)]


def declared_local(block: Block) -> set[str]:
    """The names that a function calls `local`."""
    return {s.name for s in _flat(block) if isinstance(s, (Assign, Declare)) and s.scope == "local"}


def assigned(block: Block) -> set[str]:
    """The names that a function assigns without a word; assigning an element makes no variable."""
    return {s.name for s in _flat(block) if isinstance(s, Assign) and s.scope == "free" and not s.indices}


def global_names(body: Block) -> list[str]:
    """The global variables of a program, in the order in which they appear."""
    names = dict.fromkeys(sorted(assigned(body) - declared_local(body)))
    blocks = [body]
    while blocks:
        block = blocks.pop()
        for statement in _flat(block):
            if isinstance(statement, (Assign, Declare)) and statement.scope == "global":
                names[statement.name] = None
            elif isinstance(statement, Definition):
                blocks.append(statement.body)
    return list(names)

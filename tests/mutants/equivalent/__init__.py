"""Mutations after which a program does the same to everything that a test, or a user, could see: they are not tried.

A module for each group of `targets.py`. Who adds a row says why nothing can be seen; `test_operators.py` holds each row
against the source, so that none outlives the line that it speaks of.
"""

from __future__ import annotations

from importlib import import_module
from typing import NamedTuple

from tests.mutants.operators import Mutation

__all__ = ["Equivalent", "equivalents"]


class Equivalent(NamedTuple):
    #: below src/
    path: str
    #: the name of the innermost function; None outside all
    function: str | None
    #: the text before and after the change, as `nox -f nightly.py -s mutants` prints it
    before: str
    after: str
    why: str

    def matches(self, path: str, mutation: Mutation) -> bool:
        function = mutation.function.name if mutation.function else None
        mine = (self.path, self.function, self.before, self.after)
        return mine == (path, function, mutation.before, mutation.after)


def equivalents(group: str) -> tuple[Equivalent, ...]:
    """Those of a group."""
    module = import_module(f"{__name__}.{group.replace('-', '_')}")
    rows: tuple[Equivalent, ...] = module.EQUIVALENT
    return rows

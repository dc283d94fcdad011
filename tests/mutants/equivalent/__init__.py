"""Equivalent mutations: no test and no user could see a difference, so they are not tried.

There is one module for each group of `targets.py`. Each row states why no difference is visible. `test_operators.py`
compares each row with the source, so that no row remains after its line was changed.
"""

from __future__ import annotations

from importlib import import_module
from typing import NamedTuple

from tests.mutants.operators import Mutation

__all__ = ["Equivalent", "equivalents"]


class Equivalent(NamedTuple):
    #: Path below src/.
    path: str
    #: Name of the innermost function; None outside of all functions.
    function: str | None
    #: Text before and after the change, as `nox -f nightly.py -s mutants` prints it.
    before: str
    after: str
    why: str

    def matches(self, path: str, mutation: Mutation) -> bool:
        function = mutation.function.name if mutation.function else None
        mine = (self.path, self.function, self.before, self.after)
        return mine == (path, function, mutation.before, mutation.after)


def equivalents(group: str) -> tuple[Equivalent, ...]:
    """Return the equivalent mutations of a group."""
    module = import_module(f"{__name__}.{group.replace('-', '_')}")
    rows: tuple[Equivalent, ...] = module.EQUIVALENT
    return rows

"""The directive `variables`: the table of RTDE variables, from the table that the code uses.

Registers of one kind follow each other and differ only by a number, so they share a row.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterable
from itertools import groupby
from pathlib import Path
from typing import Any

from _tables import table
from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

from urlink.protocol.rtde import variables
from urlink.protocol.rtde.variables import INPUTS, OUTPUTS, Variable

_HEAD = ("variable", "type", "meaning", "since", "evidence")
_KNOWN = {"outputs": OUTPUTS, "inputs": INPUTS}


class VariablesDirective(SphinxDirective):
    """Table of the outputs or of the inputs."""

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        """Return a table with one row for each variable, and one for each range of registers."""
        self.env.note_dependency(str(Path(inspect.getfile(variables))))
        if self.arguments[0] not in _KNOWN:
            raise self.error(f"no table of {self.arguments[0]}; expected {' or '.join(_KNOWN)}")
        return tables(self.arguments[0])


def tables(direction: str) -> list[nodes.Node]:
    """Return the table of the outputs or of the inputs."""
    return [table(_HEAD, _rows(_KNOWN[direction].values()), code=(0, 1))]


def _rows(found: Iterable[Variable]) -> Iterable[tuple[str, ...]]:
    for key, members in groupby(found, key=_key):
        group = list(members)
        first, last = group[0], group[-1]
        name, doc = first.name, first.doc
        if key is not None and len(group) > 1:
            number = _NUMBER.search(last.name)
            assert number is not None
            name = f"{first.name} to {number[1]}"
            doc = f"{re.sub(r'(, bit)? [0-9]+$', '', first.doc)}s"
        unit = f" [{first.unit}]" if first.unit else ""
        since = "" if first.since is None else first.since.text.replace("/", " / ")
        yield name, first.type, doc + unit, since, first.evidence


_NUMBER = re.compile(r"_register_([0-9]+)$")


def _key(variable: Variable) -> Any:
    """Return a key that all registers of a range share; for any other variable, its name."""
    if _NUMBER.search(variable.name) is None:
        return variable.name
    return (_NUMBER.sub("", variable.name), None if variable.since is None else variable.since.text)


def setup(app: Sphinx) -> dict[str, Any]:
    """Register the directive."""
    app.add_directive("variables", VariablesDirective)
    return {"parallel_read_safe": True, "parallel_write_safe": True}

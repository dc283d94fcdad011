"""The directive `functions`: the URScript functions that the simulated controller has, family by family."""

from __future__ import annotations

from typing import Any

from _tables import table
from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

from urlink.simulator.urscript.builtins import FAMILIES
from urlink.simulator.urscript.builtins.declaration import Family

_ALWAYS = "1.0"


class FunctionsDirective(SphinxDirective):
    """One row for each family, named as its module."""

    def run(self) -> list[nodes.Node]:
        """The table; those that are known and not acted on stand in the last row."""
        return [table(("family", "functions"), [(_name(family), _functions(family)) for family in FAMILIES])]


def _name(family: Family) -> str:
    first = next(iter(family.functions.values()))[0]
    return first.function.__module__.rpartition(".")[2].replace("_", " ")


def _functions(family: Family) -> str:
    texts = []
    for name, found in sorted(family.functions.items()):
        since = sorted(builtin.since.text for builtin in found)
        texts.append(name if _ALWAYS in since else f"{name} ({since[0].replace('/', ' / ')})")
    return ", ".join(texts)


def setup(app: Sphinx) -> dict[str, Any]:
    """Register the directive."""
    app.add_directive("functions", FunctionsDirective)
    return {"parallel_read_safe": True, "parallel_write_safe": True}

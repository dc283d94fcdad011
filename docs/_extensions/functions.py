"""The directive `functions`: the URScript functions of the simulated controller, by family."""

from __future__ import annotations

from typing import Any

from _tables import table
from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

from urlink.simulator.urscript.builtins import BUILTINS

_ALWAYS = "1.0"


class FunctionsDirective(SphinxDirective):
    """Table with one row for each family, which has the name of its module."""

    def run(self) -> list[nodes.Node]:
        """Return the table."""
        families: dict[str, list[str]] = {}
        for name, found in sorted(BUILTINS.items()):
            family = found[0].function.__module__.rpartition(".")[2].replace("_", " ")
            since = min(builtin.since.text for builtin in found)
            text = name if since == _ALWAYS else f"{name} ({since.replace('/', ' / ')})"
            families.setdefault(family, []).append(text)
        return [table(("family", "functions"), [(name, ", ".join(families[name])) for name in sorted(families)])]


def setup(app: Sphinx) -> dict[str, Any]:
    """Register the directive."""
    app.add_directive("functions", FunctionsDirective)
    return {"parallel_read_safe": True, "parallel_write_safe": True}

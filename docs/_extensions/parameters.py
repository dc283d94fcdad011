"""The directive `parameters`: rows of the table of parameters, with the modules that use them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from _tables import table
from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

import urlink.arm.parameters
from urlink.arm.parameters import Parameter, parameters

_HEAD = ("parameter", "of", "value", "interval", "evidence", "used in")


class ParametersDirective(SphinxDirective):
    """The rows with the given kind of value: `numbers` or `assumptions`."""

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        """Return a table with one row for each parameter."""
        self.env.note_dependency(str(Path(urlink.arm.parameters.__file__).with_suffix(".tsv")))
        kinds = {"numbers": False, "assumptions": True}
        if self.arguments[0] not in kinds:
            raise self.error(f"no parameters are called {self.arguments[0]}; expected {' or '.join(kinds)}")
        chosen = [each for each in parameters().values() if (each.value == "assumed") is kinds[self.arguments[0]]]
        if kinds[self.arguments[0]]:
            head = ("name", "reason for the assumption", "used in")
            return [table(head, [(p.name, p.source, p.used) for p in chosen], (0, 2))]
        return [table(_HEAD, map(_row, chosen), code=(0, 5))]


def _row(row: Parameter) -> tuple[str, ...]:
    interval = "" if row.low is None or row.high is None else f"{row.low:g} to {row.high:g}"
    value = f"{row.value} {row.unit}".strip()
    return row.name, row.of, value, interval, f"{row.evidence}: {row.source}", row.used


def setup(app: Sphinx) -> dict[str, Any]:
    """Register the directive."""
    app.add_directive("parameters", ParametersDirective)
    return {"parallel_read_safe": True, "parallel_write_safe": True}

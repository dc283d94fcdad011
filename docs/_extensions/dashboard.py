"""The directive `dashboard`: the methods of `robot.dashboard`, from the table of commands and the class itself.

The directive reads from the class which method sends which command. So the page cannot miss a command, or name a wrong
one.
"""

from __future__ import annotations

import ast
import inspect
from pathlib import Path
from typing import Any

from _tables import table
from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

from linkcore.wire.fields import Version, version_text
from urlink import Dashboard
from urlink.protocol.dashboard.commands import COMMANDS
from urlink.protocol.dashboard.robot_api import REQUESTS

_HEAD = ("method", "command", "CB2, CB3", "e-Series", "PolyScope X", "in local control", "what it does")


class DashboardDirective(SphinxDirective):
    """The table of methods and commands."""

    def run(self) -> list[nodes.Node]:
        """Return a table with one row for each command, in the order of the class."""
        self.env.note_dependency(str(Path(inspect.getfile(Dashboard))))
        missing = sorted(COMMANDS.keys() - {command for _, command, _ in methods()})
        if missing:
            raise self.error(f"no method of Dashboard sends {', '.join(missing)}")
        return tables()


def tables() -> list[nodes.Node]:
    """Return the table of methods and commands."""
    return [table(_HEAD, [_row(*one) for one in methods()], code=(0, 1))]


def methods() -> list[tuple[str, str, str]]:
    """Return (signature, command, first sentence) of each method that sends one command."""
    (tree,) = ast.parse(inspect.getsource(Dashboard)).body
    assert isinstance(tree, ast.ClassDef)
    found = []
    for part in tree.body:
        if not isinstance(part, ast.FunctionDef) or part.name.startswith("_"):
            continue
        for node in ast.walk(part):
            if isinstance(node, ast.Call) and ast.unparse(node.func) == "self._do" and len(node.args) > 0:
                command = node.args[0]
                if isinstance(command, ast.Constant):
                    arguments = ", ".join(argument.arg for argument in part.args.args[1:])
                    text = (ast.get_docstring(part) or "").partition("\n\n")[0].replace("\n", " ")
                    found.append((f"{part.name}({arguments})", str(command.value), text))
    return found


def _row(method: str, name: str, text: str) -> tuple[str, ...]:
    command = COMMANDS[name]
    line = f"{name} <{command.argument}>" if command.argument else name
    local = "refused" if command.needs_remote_control and command.e is not None else ""
    return (
        method,
        line,
        _since(command.cb),
        _since(command.e),
        _in_robot_api(name),
        local,
        text.replace("**", "").replace("`", ""),
    )


def _in_robot_api(name: str) -> str:
    return _since(REQUESTS[name][0].since if name in REQUESTS else None)


def _since(version: Version | None) -> str:
    return "-" if version is None else version_text(version)


def setup(app: Sphinx) -> dict[str, Any]:
    """Register the directive."""
    app.add_directive("dashboard", DashboardDirective)
    return {"parallel_read_safe": True, "parallel_write_safe": True}

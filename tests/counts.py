"""How much there is in src/: `python -m tests.counts` prints it, for each folder with `--folders`.

A line of code is one that is neither blank, nor a comment, nor part of a docstring; of a string that goes over several
lines, all count. Stubs (`.pyi`), which are generated and never run, are not counted.
"""

from __future__ import annotations

import argparse
import ast
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from statistics import median
from typing import NamedTuple

__all__ = ["SRC", "Module", "modules", "of_one_name"]

SRC = Path(__file__).resolve().parents[1] / "src"


class Module(NamedTuple):
    """One module.

    Attributes:
        name: dotted; a package has the name of its folder.
        code: lines of code.
        lines: lines of the file.
        classes: the classes that it defines, nested ones too; those that begin with an underscore are its own affair.
    """

    name: str
    code: int
    lines: int
    classes: tuple[str, ...]


def modules(root: Path = SRC) -> list[Module]:
    """Every module below `root`, by name."""
    return sorted(_read(path, root) for path in root.rglob("*.py"))


def _read(path: Path, root: Path) -> Module:
    text = path.read_text(encoding="utf-8")
    nodes = list(ast.walk(ast.parse(text)))
    name = ".".join(path.relative_to(root).with_suffix("").parts).removesuffix(".__init__")
    own = sorted(node.name for node in nodes if isinstance(node, ast.ClassDef) and not node.name.startswith("_"))
    return Module(name, _lines_of_code(text, nodes), len(text.splitlines()), tuple(own))


def lines_of_code(text: str) -> int:
    """How many lines of a module hold code."""
    return _lines_of_code(text, list(ast.walk(ast.parse(text))))


def _lines_of_code(text: str, nodes: Sequence[ast.AST]) -> int:
    documented = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
    strings: set[int] = set()
    docstrings: set[int] = set()
    for node in nodes:
        if isinstance(node, (ast.JoinedStr, ast.Constant)) and node.end_lineno != node.lineno:
            strings |= _lines_of(node)
        elif isinstance(node, documented) and ast.get_docstring(node, clean=False) is not None:
            docstrings |= _lines_of(node.body[0])
    written = {number for number, line in enumerate(text.split("\n"), 1) if line.strip() and line.strip()[0] != "#"}
    return len((written | strings) - docstrings)


def _lines_of(node: ast.expr | ast.stmt) -> set[int]:
    return set(range(node.lineno, (node.end_lineno or node.lineno) + 1))


def of_one_name(found: Iterable[Module]) -> dict[str, list[str]]:
    """The names that several classes have, each with the modules that define one."""
    homes: dict[str, list[str]] = {}
    for module in found:
        for name in module.classes:
            homes.setdefault(name, []).append(module.name)
    return {name: where for name, where in sorted(homes.items()) if len(where) > 1}


def report(found: Sequence[Module], *, folders: bool = False) -> Iterator[str]:
    """What is printed, line by line."""
    if folders:
        parts: dict[str, list[Module]] = {}
        packages = {module.name.rpartition(".")[0] for module in found}
        for module in found:
            own = module.name if module.name in packages else module.name.rpartition(".")[0]
            parts.setdefault(own, []).append(module)
        for name, inside in sorted(parts.items()):
            yield f"{name:36} {_figures(inside)}"
    yield f"{'all':36} {_figures(found)}"
    for package in ("urlink", "rhdlink"):
        yield f"public names of {package:20} {len(vars(__import__(package))['__all__']):4}"
    yield f"classes of one name {len(of_one_name(found)):20}"


def _figures(of: Sequence[Module]) -> str:
    code = [module.code for module in of]
    middle = f"median {median(code):5.0f} of code, {median(module.lines for module in of):5.0f} with documentation"
    return f"{len(of):4} modules {sum(code):6} lines of code, {middle}"


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--folders", action="store_true", help="a line for each folder too")
    print("\n".join(report(modules(), folders=parser.parse_args().folders)))

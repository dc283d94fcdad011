"""Recipes of CONTRIBUTING: step-by-step instructions to add something, which a test executes.

A recipe is a section whose heading begins with "Adding". Each numbered step that edits a file begins with the file and
the place. Then it shows the text to insert, with the indentation that the text has in the file::

    1. In `src/rhdlink/smrcl/commands.py`, below `_TABLE = (`:
    2. In `src/rhdlink/smrcl/driving.py`, at the end:
    3. In `docs/smrcl.md`, above `| stop |`:
    4. New file `src/urlink/cli/shout.py`:

The line of the place is the only line of the file that begins with the text in backticks, ignoring white space. A
last Python block below "Check:" is a program that fails if the recipe is incomplete. A command after "Run" in the same
paragraph is also executed.
"""

from __future__ import annotations

import re
import shlex
import textwrap
from dataclasses import dataclass
from pathlib import Path

__all__ = ["ROOT", "Edit", "Recipe", "recipes"]

ROOT = Path(__file__).resolve().parents[1]
_PAGE = ROOT / "CONTRIBUTING.md"

_IN_FILE = re.compile(r"In `([^`]+)`, (?:(above|below) (`+) ?(.+?) ?\3(?!`)|at the (end))")
_NEW_FILE = re.compile(r"New file `([^`]+)`")
_BLOCK = re.compile(r"^( *)```\w+\n(.*?)^ *```$", re.MULTILINE | re.DOTALL)


@dataclass(frozen=True)
class Edit:
    """Step of a recipe: text to insert into a file, or a new file.

    Attributes:
        path: The file, relative to the repository.
        text: The text to insert.
        place: "above" or "below" a line, "end", or "new".
        anchor: How the line begins, for "above" and "below".
    """

    path: str
    text: str
    place: str
    anchor: str = ""

    def apply(self, root: Path) -> None:
        """Make this edit in a copy of the repository.

        Raises:
            LookupError: If the page names a file or a line that does not exist, or a line that exists twice.
        """
        path = root / self.path
        if (self.place == "new") == path.exists():
            raise LookupError(f"CONTRIBUTING.md: {self.path} {'exists already' if path.exists() else 'does not exist'}")
        before = path.read_text(encoding="utf-8") if path.exists() else ""
        path.write_text(self.applied(before), encoding="utf-8")

    def applied(self, before: str) -> str:
        """Return the text of the file with this edit.

        Raises:
            LookupError: If not exactly one line begins with the anchor.
        """
        lines = before.splitlines(keepends=True)
        if self.place in ("end", "new"):
            return before + ("\n\n" if before and self.path.endswith(".py") else "") + self.text
        found = [number for number, line in enumerate(lines) if " ".join(line.split()).startswith(self.anchor)]
        if len(found) != 1:
            raise LookupError(
                f"CONTRIBUTING.md: {len(found)} lines of {self.path} begin with {self.anchor!r}; expected 1. "
                "Edit the step of the recipe"
            )
        at = found[0] + (self.place == "below")
        return "".join(lines[:at]) + self.text + "".join(lines[at:])


@dataclass(frozen=True)
class Recipe:
    """Section of the page.

    Attributes:
        name: Name of the thing to add, as in "a firmware".
        edits: Steps that edit files.
        check: Program that fails unless the addition works.
        commands: Command lines to run before the check, as arguments of Python.
    """

    name: str
    edits: tuple[Edit, ...]
    check: str
    commands: tuple[tuple[str, ...], ...]


def recipes() -> list[Recipe]:
    """Return all recipes of the page."""
    page = _PAGE.read_text(encoding="utf-8")
    sections = re.findall(r"^## Adding ([^\n]+)\n(.*?)(?=^## |\Z)", page, re.MULTILINE | re.DOTALL)
    return [_recipe(name, text) for name, text in sections]


def _recipe(name: str, text: str) -> Recipe:
    steps, found, end = text.partition("\nCheck:")
    if not found or not (program := _BLOCK.search(end)):
        raise LookupError(f"CONTRIBUTING.md: the section 'Adding {name}' has no program below 'Check:'")
    edits = []
    for step in re.split(r"^(?=\d+\. )", steps, flags=re.MULTILINE)[1:]:
        block = _BLOCK.search(step)
        head = " ".join((step if block is None else step[: block.start()]).split())
        if block is None:
            continue
        indent, code = block.groups()
        code = re.sub(rf"^{indent}", "", code, flags=re.MULTILINE)
        if new := _NEW_FILE.search(head):
            edits.append(Edit(new[1], code, "new"))
        elif place := _IN_FILE.search(head):
            edits.append(Edit(place[1], code, place[2] or place[5], place[4] or ""))
        else:
            raise LookupError(f"CONTRIBUTING.md: the step {head!r} of 'Adding {name}' does not begin with its file")
    commands = re.findall(r"\bRun\s+`python ([^`]+)`", steps)
    return Recipe(
        name, tuple(edits), textwrap.dedent(program[2]), tuple(tuple(shlex.split(command)) for command in commands)
    )

"""Programs with the constructs of public programs, as PolyScope, URCaps and people write them; all are our own.

`corpus.txt` has a section for each construct: its name, the lines before the program's own statements, and the
statements. This module combines every pair of constructs in one program, to check that they also work together. `@`
becomes 1 in the first of a pair and 2 in the second, so that all names differ. The requirements on the controller are
in docs/protocols/urscript.md, under "What public programs need of an interpreter".
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from pathlib import Path

__all__ = ["programs"]


def programs() -> Iterator[tuple[str, str]]:
    """Yield names and texts: each construct alone, and every two constructs in one program."""
    sections = Path(__file__).with_name("corpus.txt").read_text(encoding="utf-8").split("=== ")[1:]
    parts = dict(section.split("\n", 1) for section in sections)
    for names in (*((name,) for name in parts), *itertools.combinations(parts, 2)):
        before: list[str] = []
        body: list[str] = []
        for number, name in enumerate(names, 1):
            above, _, below = parts[name].replace("@", str(number)).partition("---\n")
            before += above.splitlines()
            body += below.splitlines()
        text = ["def program():", *(f"  {line}" for line in [*before, *body]), "end"]
        yield " and ".join(names), "\n".join(text) + "\n"

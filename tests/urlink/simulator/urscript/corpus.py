"""Programs with the constructs that public programs have, as PolyScope, URCaps and people write them; all are our own.

`corpus.txt` has each construct: its name, what stands before the program's own statements, and those. Here they are put
together in every pair, so that what works by itself works beside the others too. `@` becomes 1 in the first of a pair
and 2 in the second, so that no name stands twice. What they need of a controller is what docs/protocols/urscript.md has
under "What public programs need of an interpreter".
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from pathlib import Path

__all__ = ["programs"]


def programs() -> Iterator[tuple[str, str]]:
    """Names and texts: each construct by itself, and every two of them in one program."""
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

"""The defects that are drawn from `defects`: by which seed, how many, and from which packages.

The seed was committed before the operators of `defects` were written, so nobody could choose what it draws.
"""

from __future__ import annotations

__all__ = ["COUNT", "MODULES", "SECOND_SEED", "SEED"]

#: Seed of the random choice.
SEED = 20_261_128
#: Seed of a second draw, for what was learned from the first one. It was committed before anything of it was looked at.
SECOND_SEED = 31_415_926
#: Number of defects that are drawn.
COUNT = 200
#: Patterns of the modules below src/ from which they are drawn.
MODULES = (
    "urlink/command/*.py",
    "urlink/motion/**/*.py",
    "urlink/aio/*.py",
    "urlink/rtde/*.py",
    "linkcore/streaming/*.py",
    "linkcore/aio/*.py",
    "rhdlink/*.py",
)

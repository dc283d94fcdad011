"""Random draw of defects from `defects`: its seed, its number of defects, and its packages.

The seed was committed before the operators of `defects` were written, so the drawn defects could not be chosen.
"""

from __future__ import annotations

__all__ = ["COUNT", "MODULES", "SECOND_SEED", "SEED"]

#: Seed of the random choice.
SEED = 20_261_128
#: Seed of a second draw, to test the lessons from the first one. It was committed before its defects were looked at.
SECOND_SEED = 31_415_926
#: Number of drawn defects.
COUNT = 200
#: Patterns of the modules below src/ that contain the drawn defects.
MODULES = (
    "urlink/command/*.py",
    "urlink/motion/**/*.py",
    "urlink/aio/*.py",
    "urlink/rtde/*.py",
    "linkcore/streaming/*.py",
    "linkcore/aio/*.py",
    "rhdlink/*.py",
    "rhdlink/sync/*.py",
)

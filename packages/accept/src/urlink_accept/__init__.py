"""Tests of a controller with this library, and what a recording tells of its arm.

`acceptance` tries a controller stage by stage and leaves evidence. `identification` fits the parameters of the
simulator to a recording, and makes the motion that such a recording needs.
"""

# Before urlink, so that a warning about another distribution of that name comes before an import fails.
import linkcore  # noqa: F401

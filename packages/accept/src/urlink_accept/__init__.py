"""Tests of a controller with urlink, and identification of an arm from a recording.

`acceptance` tests a controller stage by stage and stores the evidence. `identification` fits the parameters of the
simulator to a recording, and makes the motion that such a recording needs.
"""

# Imported before urlink, so that a warning about another distribution of this name precedes a failing import.
import linkcore  # noqa: F401

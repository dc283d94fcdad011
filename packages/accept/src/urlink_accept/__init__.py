"""Tests of a controller with urlink, and identification of an arm from a recording.

`acceptance` tests a controller stage by stage and stores the evidence. `identification` fits the parameters of the
simulator to a recording. `identification` can also move the arm to make such a recording.
"""

# Imported before urlink: if another distribution has this name, its warning is shown before an import fails.
import linkcore  # noqa: F401

"""Classes and calls of other clients, implemented with urlink, for programs that were written for these clients.

`rtde_control`, `rtde_receive` and `rtde_io` have the classes of ur_rtde 1.6.5, and `urx` has the robot of urx 0.11,
with their methods and the order of their arguments. docs/coming-from-ur-rtde.md describes the differences and the
reasons.
"""

# Imported before urlink, so that a warning about another distribution of this name precedes a failing import.
import linkcore  # noqa: F401

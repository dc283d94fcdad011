"""The classes and calls of other clients, over this library: for programs that were written for those clients.

`rtde_control`, `rtde_receive` and `rtde_io` have the classes of ur_rtde 1.6.5, and `urx` the robot of urx 0.11, with
their methods and the order of their arguments. What differs, and why, is in docs/coming-from-ur-rtde.md.
"""

# Before urlink, so that a warning about another distribution of that name comes before an import fails.
import linkcore  # noqa: F401

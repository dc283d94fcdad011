"""Universal Robots arms over Robot Raconteur: the standard service `com.robotraconteur.robotics.robot` of each.

`serve` registers robots in a node, `RobotService` is the service of one of them. `RhdService` has the variables of a
mobile robot that runs RHD as wires.
"""

from __future__ import annotations

# Before urlink, so that a warning about another distribution of that name comes before an import fails.
import linkcore  # noqa: F401

from .node import open_node, register, serve
from .rhd import RhdService, register_rhd
from .service import RobotService

__all__ = ["RhdService", "RobotService", "open_node", "register", "register_rhd", "serve"]

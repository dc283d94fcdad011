"""Universal Robots arms over Robot Raconteur: the standard service `com.robotraconteur.robotics.robot` of each.

`serve` registers robots in a node, `RobotService` is the service of one of them. `RhdService` has the variables of a
mobile robot that runs RHD as wires.
"""

from __future__ import annotations

from .node import open_node, register, serve
from .rhd import RhdService, register_rhd
from .service import RobotService

__all__ = ["RhdService", "RobotService", "open_node", "register", "register_rhd", "serve"]

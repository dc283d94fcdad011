"""Universal Robots arms over Robot Raconteur, each as a service `com.robotraconteur.robotics.robot`.

`serve` registers robots in a node. `RobotService` is the service of one robot. `RhdService` makes the variables of a
mobile robot that runs RHD available as wires.
"""

from __future__ import annotations

# Before urlink: the warning about another distribution named linkcore must come before an import fails.
import linkcore  # noqa: F401

from .node import open_node, register, serve
from .rhd import RhdService, register_rhd
from .service import RobotService

__all__ = ["RhdService", "RobotService", "open_node", "register", "register_rhd", "serve"]

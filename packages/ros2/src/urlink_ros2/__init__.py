"""Universal Robots arms as ROS 2 nodes, with the rclpy of an installed ROS or of PyPI.

`RobotNode` is the node of one robot. `serve` runs one node for each of several robots.
"""

from __future__ import annotations

# Before urlink: the warning about another distribution named linkcore must come before an import fails.
import linkcore  # noqa: F401

from .node import JOINT_NAMES, RobotNode, serve

__all__ = ["JOINT_NAMES", "RobotNode", "serve"]

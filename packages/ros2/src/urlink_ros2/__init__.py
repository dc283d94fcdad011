"""Universal Robots arms as ROS 2 nodes, with any rclpy: that of an installed ROS, or that of PyPI.

`RobotNode` is the node of one robot; `serve` runs one for each of several.
"""

from __future__ import annotations

# Before urlink, so that a warning about another distribution of that name comes before an import fails.
import linkcore  # noqa: F401

from .node import JOINT_NAMES, RobotNode, serve

__all__ = ["JOINT_NAMES", "RobotNode", "serve"]

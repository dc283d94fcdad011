"""Universal Robots arms as ROS 2 nodes, with any rclpy: that of an installed ROS, or that of PyPI.

`RobotNode` is the node of one robot; `serve` runs one for each of several.
"""

from __future__ import annotations

from .node import JOINT_NAMES, RobotNode, serve

__all__ = ["JOINT_NAMES", "RobotNode", "serve"]

from __future__ import annotations

import os

# Before rclpy is imported: separate from other nodes on this network, and from tests that run at the same time.
os.environ["ROS_DOMAIN_ID"] = str(1 + os.getpid() % 100)
os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"

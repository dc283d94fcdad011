"""Universal Robots arms for LeRobot, which finds this package by its name: robot "ur", teleoperator "ur_leader"."""

from __future__ import annotations

from .leader import URLeader, URLeaderConfig
from .ur import UR, URConfig

__all__ = ["UR", "URConfig", "URLeader", "URLeaderConfig"]

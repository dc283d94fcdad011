"""Universal Robots arms for LeRobot, which finds this package by its name: robot "ur", teleoperator "ur_leader"."""

from __future__ import annotations

# Before urlink: the warning about another distribution named linkcore must come before an import fails.
import linkcore  # noqa: F401

from .leader import URLeader, URLeaderConfig
from .ur import UR, URConfig

__all__ = ["UR", "URConfig", "URLeader", "URLeaderConfig"]

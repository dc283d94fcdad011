"""The motion generator of a simulated controller: from movej and the like to set-points, cycle by cycle."""

from __future__ import annotations

from .compliance import ForceTask
from .drive import ArmDrive
from .joint_limits import LimitViolation, OutOfReach
from .motion_generator import MotionGenerator
from .path_motion import Command

__all__ = ["ArmDrive", "Command", "ForceTask", "LimitViolation", "MotionGenerator", "OutOfReach"]

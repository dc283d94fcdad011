"""Motion generator of a simulated controller, which converts motion commands to set-points."""

from __future__ import annotations

from .compliance import ForceTask
from .drive import ArmDrive
from .joint_limits import LimitViolation, OutOfReach
from .motion_generator import MotionGenerator
from .path_motion import Command

__all__ = ["ArmDrive", "Command", "ForceTask", "LimitViolation", "MotionGenerator", "OutOfReach"]

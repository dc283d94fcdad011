"""The motion generator of a simulated controller: from movej and the like to set-points, cycle by cycle."""

from __future__ import annotations

from .compliance import ForceTask
from .drive import Drive
from .joint_limits import LimitViolation, Unreachable
from .motion_generator import MotionGenerator
from .path_motion import Move

__all__ = ["Drive", "ForceTask", "LimitViolation", "MotionGenerator", "Move", "Unreachable"]

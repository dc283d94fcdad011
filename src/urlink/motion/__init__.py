"""Motions of the arm: `robot.motion` is a `Motions`, and this is what it begins and returns."""

from .contact import Contact, ContactMotion
from .following import TrajectoryFeedback
from .force_mode import ForceMode
from .freedrive import Freedrive
from .jog import Jog
from .motions import Motions
from .path import PathMotion, Waypoint
from .servo import Servo, ServoStatistics
from .taught import TaughtPoint
from .teaching import Teaching
from .torque import Torque

__all__ = [
    "Contact",
    "ContactMotion",
    "ForceMode",
    "Freedrive",
    "Jog",
    "Motions",
    "PathMotion",
    "Servo",
    "ServoStatistics",
    "TaughtPoint",
    "Teaching",
    "Torque",
    "TrajectoryFeedback",
    "Waypoint",
]

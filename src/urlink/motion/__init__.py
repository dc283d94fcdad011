"""Motions of the arm; `robot.motion` is a `Motions`."""

from .contact import Contact, ContactMotion
from .following import TrajectoryFeedback
from .force_mode import ForceMode
from .freedrive import Freedrive
from .jog import Jog
from .motions import Motions
from .path import Circular, Joint, Linear, PathMotion, Waypoint
from .servo import Servo, ServoStatistics
from .taught import Taught, TaughtPoint
from .teaching import Teaching
from .torque import Torque

__all__ = [
    "Circular",
    "Contact",
    "ContactMotion",
    "ForceMode",
    "Freedrive",
    "Jog",
    "Joint",
    "Linear",
    "Motions",
    "PathMotion",
    "Servo",
    "ServoStatistics",
    "Taught",
    "TaughtPoint",
    "Teaching",
    "Torque",
    "TrajectoryFeedback",
    "Waypoint",
]

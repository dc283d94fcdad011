"""Moving the arm: `Motions` is what `robot.motion` is."""

from .contact import Contact, ContactMotion
from .following import TrajectoryFeedback
from .force_mode import ForceMode
from .freedrive import Freedrive
from .jog import Jog
from .motions import Motions
from .path import Circular, Joint, Linear, PathMotion, Waypoint
from .servo import Servo, ServoStatistics
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
    "Torque",
    "TrajectoryFeedback",
    "Waypoint",
]

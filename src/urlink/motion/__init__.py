"""Moving the arm: `Motions` is what `robot.motion` is."""

from .following import TrajectoryFeedback
from .jog import Jog
from .motions import Motions
from .path import Circular, Joint, Linear, PathMotion, Waypoint
from .servo import Servo, ServoStatistics

__all__ = [
    "Circular",
    "Jog",
    "Joint",
    "Linear",
    "Motions",
    "PathMotion",
    "Servo",
    "ServoStatistics",
    "TrajectoryFeedback",
    "Waypoint",
]

"""Motions of the arm: `robot.motion` is a `Motions`, and this is what it begins and returns."""

from .following import TrajectoryFeedback
from .impedance import Impedance
from .jog import Jog
from .motions import Motions
from .path import PathMotion, Waypoint
from .point_stream import PointStream
from .servo import Servo, ServoStatistics
from .stream_points import PosePoint
from .teaching import TaughtPoint, Teaching
from .yielding import Contact, ContactMotion, ForceMode, Freedrive, Torque

__all__ = [
    "Contact",
    "ContactMotion",
    "ForceMode",
    "Freedrive",
    "Impedance",
    "Jog",
    "Motions",
    "PathMotion",
    "PointStream",
    "PosePoint",
    "Servo",
    "ServoStatistics",
    "TaughtPoint",
    "Teaching",
    "Torque",
    "TrajectoryFeedback",
    "Waypoint",
]

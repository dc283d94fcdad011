"""Motions of the arm: `robot.motion` is a `Motions`, and the other classes are its handles."""

from ..arm.payload import MeasuredPayload
from .motions import Motions
from .moves.path import PathMotion, Waypoint
from .points.point import PointCheck
from .points.points import Points
from .servo.following import TrajectoryFeedback
from .servo.force_control import Contact, ContactMotion, ForceMode, Freedrive, Torque
from .servo.impedance import Impedance
from .servo.jog import Jog
from .servo.servo import Servo, ServoStatistics
from .stream.point_stream import PointStream
from .stream.stream_points import PosePoint
from .teaching import TaughtPoint, Teaching
from .wrench import Wrench, WrenchStream

__all__ = [
    "Contact",
    "ContactMotion",
    "ForceMode",
    "Freedrive",
    "Impedance",
    "Jog",
    "MeasuredPayload",
    "Motions",
    "PathMotion",
    "PointCheck",
    "PointStream",
    "Points",
    "PosePoint",
    "Servo",
    "ServoStatistics",
    "TaughtPoint",
    "Teaching",
    "Torque",
    "TrajectoryFeedback",
    "Waypoint",
    "Wrench",
    "WrenchStream",
]

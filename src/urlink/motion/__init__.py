"""Moving the arm: `Motions` is what `robot.motion` is."""

from .following import TrajectoryFeedback
from .motions import Motions
from .servo import Servo, ServoStatistics

__all__ = ["Motions", "Servo", "ServoStatistics", "TrajectoryFeedback"]

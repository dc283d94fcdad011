"""Moving the arm: `Motions` is what `robot.motion` is, `Motion` the handle that its methods return."""

from .following import TrajectoryFeedback
from .handle import Motion, MotionPhase
from .moves import Motions
from .servo import Servo, ServoStatistics

__all__ = ["Motion", "MotionPhase", "Motions", "Servo", "ServoStatistics", "TrajectoryFeedback"]

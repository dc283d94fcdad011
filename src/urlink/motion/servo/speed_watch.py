"""Watch that keeps an arm within the limits of a session while it moves at a speed."""

from __future__ import annotations

from ...arm.vectors import FloatArray
from ...protocol.realtime.packets import RealtimeState
from ..limited import LimitedArm
from .following import AHEAD


class SpeedWatch:
    """Watch of an arm that moves at a speed: in each cycle, it checks that the arm could still come to rest.

    A longer prediction would have to include times that are unknown before the motion, such as the duration of the
    start of its program. So it would refuse motions that stay inside.

    Args:
        limited: Arm of the session, with its tool.
        acceleration: Acceleration for changes of the speed and for braking, in rad/s², or in m/s² and rad/s².
        is_tool: Whether the speeds are those of the tool in the base frame, rather than those of the joints.
    """

    def __init__(self, limited: LimitedArm, acceleration: float, *, is_tool: bool) -> None:
        self._limited = limited
        self._acceleration = acceleration
        self._is_tool = is_tool

    def check(self, state: RealtimeState, speeds: FloatArray) -> None:
        """Check that the arm can move at these speeds until the next state.

        Args:
            state: Newest state of the robot.
            speeds: Speeds, (6,) in rad/s, or in m/s and rad/s.

        Raises:
            LimitExceeded: If the arm could then no longer come to rest within the limits.
        """
        limited = self._limited
        limited.q, limited.qd = state.q_target, state.qd_target
        # The message after the next state takes effect after this time.
        seconds = AHEAD * limited.cycle
        if self._is_tool:
            limited.check_tool_stop(speeds, self._acceleration, seconds)
        else:
            limited.check_joint_stop(speeds, self._acceleration, seconds)

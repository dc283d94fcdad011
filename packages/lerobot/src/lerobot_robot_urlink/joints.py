"""Names of the observations and actions in a data set, and the state that observations are read from.

The names end in ``.pos`` or ``.vel``, because ``lerobot-rollout`` 0.6.1 ignores other names: it passes them neither
from an observation to a policy nor from an action to the robot (``lerobot/rollout/context.py``, build_rollout_context).
"""

from __future__ import annotations

from collections.abc import Sequence

from urlink import Robot
from urlink.packets import RealtimeState

__all__ = ["FORCE", "GRIPPER", "JOINT_DELTAS", "POSE", "POSE_DELTAS", "POSITIONS", "STATE_TIMEOUT", "VELOCITIES"]
__all__ += ["named", "newest"]

#: Maximum time, in s, until a state arrives.
STATE_TIMEOUT = 1.0
#: Joint positions in rad, base to wrist 3.
POSITIONS = tuple(f"joint_{number}.pos" for number in range(1, 7))
#: Joint velocities in rad/s.
VELOCITIES = tuple(f"joint_{number}.vel" for number in range(1, 7))
#: Changes of the joint set-points, in rad.
JOINT_DELTAS = tuple(f"joint_{number}_delta.pos" for number in range(1, 7))
#: Pose of the tool in the base frame: position in m, and the first two columns of its rotation matrix. A rotation
#: vector jumps if the tool points down. The mean of two such sets of six numbers is close to both.
POSE = (*(f"tcp_{axis}.pos" for axis in "xyz"), *(f"tcp_r{number}.pos" for number in range(1, 7)))
#: Changes of the tool's set-point along the axes of the base: m, and a rotation vector in rad.
POSE_DELTAS = tuple(f"tcp_{axis}_delta.pos" for axis in ("x", "y", "z", "rx", "ry", "rz"))
#: Force and torque at the tool along the axes of the base, in N and Nm.
FORCE = tuple(f"tcp_force.{axis}" for axis in ("x", "y", "z", "rx", "ry", "rz"))
#: Position of the gripper, 0 (open) to 1 (closed).
GRIPPER = "gripper.pos"


def named(names: Sequence[str], values: Sequence[float]) -> dict[str, float]:
    """Return the values by name."""
    return dict(zip(names, values, strict=True))


def newest(robot: Robot) -> RealtimeState:
    """Return the newest state of the arm, or the next one if it is older than `STATE_TIMEOUT`.

    Raises:
        LinkTimeout: If no state arrives within `STATE_TIMEOUT`.
    """
    state = robot.realtime.latest
    if state is None or state.received is None or state.received.age > STATE_TIMEOUT:
        return robot.realtime.wait(STATE_TIMEOUT)
    return state

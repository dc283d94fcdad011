"""The names that observations and actions have in a data set, and the state that they are of.

They end in ``.pos`` or ``.vel``: ``lerobot-rollout`` 0.6.1 gives a policy nothing else of an observation, and sends
nothing else of an action (``lerobot/rollout/context.py``, build_rollout_context).
"""

from __future__ import annotations

from collections.abc import Sequence

from urlink import Robot
from urlink.packets import RealtimeState

__all__ = ["FORCE", "GRIPPER", "JOINT_DELTAS", "POSE", "POSE_DELTAS", "POSITIONS", "STATE_TIMEOUT", "VELOCITIES"]
__all__ += ["named", "newest"]

#: Seconds within which a state has to come.
STATE_TIMEOUT = 1.0
#: rad, base to wrist 3.
POSITIONS = tuple(f"joint_{number}.pos" for number in range(1, 7))
#: rad/s.
VELOCITIES = tuple(f"joint_{number}.vel" for number in range(1, 7))
#: rad, from where the joints are led.
JOINT_DELTAS = tuple(f"joint_{number}_delta.pos" for number in range(1, 7))
#: The pose of the tool in the base frame: m, and the first two columns of its rotation matrix. A rotation vector jumps
#: where the tool points down; of these six numbers a mean of two is near both.
POSE = (*(f"tcp_{axis}.pos" for axis in "xyz"), *(f"tcp_r{number}.pos" for number in range(1, 7)))
#: m, and a rotation vector in rad, both along the axes of the base, from where the tool is led.
POSE_DELTAS = tuple(f"tcp_{axis}_delta.pos" for axis in ("x", "y", "z", "rx", "ry", "rz"))
#: The force at the tool, N and Nm, along the axes of the base.
FORCE = tuple(f"tcp_force.{axis}" for axis in ("x", "y", "z", "rx", "ry", "rz"))
#: 0 (open) to 1 (closed).
GRIPPER = "gripper.pos"


def named(names: Sequence[str], values: Sequence[float]) -> dict[str, float]:
    """Values by name."""
    return dict(zip(names, values, strict=True))


def newest(robot: Robot) -> RealtimeState:
    """The newest state of the arm, or the next one where that is older than `STATE_TIMEOUT`.

    Raises:
        LinkTimeout: nothing has come of the arm for as long.
    """
    state = robot.realtime.latest
    if state is None or state.received is None or state.received.age > STATE_TIMEOUT:
        return robot.realtime.wait(STATE_TIMEOUT)
    return state

"""The names that observations and actions have in a data set, and the state that they are of."""

from __future__ import annotations

from collections.abc import Sequence

from urlink import Robot
from urlink.packets import RealtimeState

__all__ = ["POSITIONS", "STATE_TIMEOUT", "TOOL", "VELOCITIES", "named", "newest"]

#: Seconds within which a state has to come.
STATE_TIMEOUT = 1.0
#: rad, base to wrist 3.
POSITIONS = tuple(f"joint_{number}.pos" for number in range(1, 7))
#: rad/s.
VELOCITIES = tuple(f"joint_{number}.vel" for number in range(1, 7))
#: The pose of the tool in the base frame, m and rotation vector in rad, and the force at it, N and Nm.
TOOL = (
    *(f"tcp.{axis}" for axis in ("x", "y", "z", "rx", "ry", "rz")),
    *(f"tcp_force.{axis}" for axis in ("x", "y", "z", "rx", "ry", "rz")),
)


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

"""The names that observations and actions have in a data set."""

from __future__ import annotations

from collections.abc import Sequence

__all__ = ["POSITIONS", "TOOL", "VELOCITIES", "named"]

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

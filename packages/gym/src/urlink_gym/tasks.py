"""Tasks: rewards, the end of an episode, and additional observations."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from gymnasium.spaces import Box, Space
from numpy.typing import NDArray

from urlink import BadValue

if TYPE_CHECKING:
    from .arm_env import ArmEnv, Observation

__all__ = ["Reach", "Task", "reach_env"]


class Task:
    """Task without a reward. Inherit from it, and override the methods that your task needs."""

    def spaces(self) -> dict[str, Space[Any]]:
        """Return the spaces of the observations that the task adds, by name."""
        return {}

    def reset(self, env: ArmEnv) -> None:
        """Prepare an episode. The arm is at its home position, and at rest. Draw numbers from `env.np_random`."""

    def observe(self, env: ArmEnv) -> dict[str, Any]:
        """Return the observations that the task adds, as new arrays."""
        return {}

    def judge(self, env: ArmEnv, observation: Observation) -> tuple[float, bool]:
        """Return the reward of a step, and whether the episode is solved."""
        return 0.0, False


class Reach(Task):
    """Move the TCP to a random position. The reward is the negative distance, in m.

    Args:
        box: Lowest and highest corner of the box from which goals are drawn, in m in the base frame.
        tolerance: Distance in m at which the episode is solved.

    Raises:
        BadValue: If the box or the tolerance is invalid.
    """

    def __init__(self, box: Any = ((-0.6, -0.3, 0.2), (-0.35, 0.1, 0.5)), tolerance: float = 0.02) -> None:
        corners = np.asarray(box, np.float64)
        if corners.shape != (2, 3) or not np.isfinite(corners).all() or (corners[0] > corners[1]).any():
            raise BadValue(f"box={box!r}; expected its lowest and highest corner, ((x, y, z), (x, y, z)), in m")
        if not 0.0 < tolerance <= 1.0:
            raise BadValue(f"tolerance={tolerance!r}; expected a distance above 0 and at most 1 m")
        self._corners = corners
        self.tolerance = tolerance
        self.goal: NDArray[np.float32] = corners.mean(axis=0).astype(np.float32)

    def spaces(self) -> dict[str, Space[Any]]:
        """Return the space of `goal`: its position in the base frame, in m."""
        return {"goal": Box(-10.0, 10.0, (3,), np.float32)}

    def reset(self, env: ArmEnv) -> None:
        """Draw a new goal."""
        low, high = self._corners
        self.goal = np.asarray(env.np_random.uniform(low, high), np.float32)

    def observe(self, env: ArmEnv) -> dict[str, Any]:
        """Return the goal."""
        return {"goal": self.goal.copy()}

    def judge(self, env: ArmEnv, observation: Observation) -> tuple[float, bool]:
        """Return the negative distance between the TCP and the goal, and whether it is within the tolerance."""
        distance = float(np.linalg.norm(observation["tool_position"] - self.goal))
        return -distance, distance <= self.tolerance


def reach_env(robot: Any = "sim://", **options: Any) -> ArmEnv:
    """Return an `ArmEnv` with the task `Reach`; `gymnasium.make("urlink/Reach-v0")` calls this.

    Args:
        robot, options: See `ArmEnv`. `box` and `tolerance` belong to `Reach`. The default of `action` is
            `position_deltas`.
    """
    from .arm_env import ArmEnv

    task = Reach(**{name: options.pop(name) for name in ("box", "tolerance") if name in options})
    return ArmEnv(robot, options.pop("action", "position_deltas"), task=task, **options)

"""Gymnasium environments for Universal Robots arms: the simulator, MuJoCo and a real arm, in the same class.

    import gymnasium
    import urlink_gym

    env = gymnasium.make("urlink/Reach-v0", robot="sim://ur5e")

Importing the package registers `urlink/Arm-v0` (no task) and `urlink/Reach-v0`. It connects to nothing.
"""

from __future__ import annotations

from gymnasium.envs.registration import register

# Before urlink: the warning about another distribution named linkcore must come before an import fails.
import linkcore  # noqa: F401

from .actions import KINDS, Actions, Steps
from .arm_env import ArmEnv
from .chunks import ChunkFollower, Moment
from .intervention import LeaderArm, held
from .tasks import Reach, Task

__all__ = ["KINDS", "Actions", "ArmEnv", "ChunkFollower", "LeaderArm", "Moment", "Reach", "Steps", "Task", "held"]

# A real arm never repeats an episode exactly, and neither does a simulator with noise.
register(id="urlink/Arm-v0", entry_point="urlink_gym.arm_env:ArmEnv", nondeterministic=True)
register(
    id="urlink/Reach-v0",
    entry_point="urlink_gym.tasks:reach_env",
    nondeterministic=True,
    max_episode_steps=200,
)

"""Push a box over a table in MuJoCo. The task of this example has an observation and a reward.

A simple law moves the tool against the box until the box is at its goal. Replace `law` with your policy.

python packages/gym/examples/push_box.py
"""

import argparse
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from gymnasium.spaces import Box

import urlink
import urlink_gym
from urlink.arm.kinematics import Arm

SCENE = Path(__file__).with_name("box.xml")
#: Goal of the box along y, and the distance at which the episode is solved, in m.
GOAL, TOLERANCE = 0.2, 0.01
#: The tool points down, next to the box. The gripper is 0.145 m long.
TCP = (0.0, 0.0, 0.145, 0.0, 0.0, 0.0)
START = Arm("UR5e").inverse((-0.45, -0.1, 0.06, np.pi, 0.0, 0.0), urlink_gym.arm_env.HOME, TCP)


def world(env: urlink_gym.ArmEnv) -> Any:
    """Return the `urlink_mujoco.MujocoWorld` around the arm."""
    scene: Any = env.robot.controller.world.scene
    return scene.world


class Push(urlink_gym.Task):
    """Push the box along y to `GOAL`."""

    def spaces(self) -> dict[str, gymnasium.Space[Any]]:
        return {"box": Box(-10.0, 10.0, (3,), np.float32)}

    def reset(self, env: urlink_gym.ArmEnv) -> None:
        world(env).reset()

    def observe(self, env: urlink_gym.ArmEnv) -> dict[str, np.ndarray]:
        return {"box": world(env).pose("box")[:3].astype(np.float32)}

    def judge(self, env: urlink_gym.ArmEnv, observation: dict[str, np.ndarray]) -> tuple[float, bool]:
        away = abs(float(observation["box"][1]) - GOAL)
        return -away, away < TOLERANCE


def make() -> gymnasium.Env[Any, Any]:
    """Return the environment; a step moves the tool by up to 5 mm."""
    return gymnasium.make(
        "urlink/Arm-v0",
        robot=f"sim://ur5e?scene={SCENE}",
        action="position_deltas",
        home=START,
        steps=urlink_gym.Steps(move=0.005),
        task=Push(),
        max_episode_steps=120,
    )


def law(observation: dict[str, np.ndarray]) -> np.ndarray:
    """Move along y until the box is at its goal."""
    away = GOAL - float(observation["box"][1])
    return np.array([0.0, np.clip(away / 0.02, -1.0, 1.0), 0.0])


def main() -> None:
    argparse.ArgumentParser(description="Push a box in MuJoCo.").parse_args()
    with urlink.simulated_time(seed=1), make() as env:
        observation, _ = env.reset()
        terminated = truncated = False
        while not (terminated or truncated):
            observation, reward, terminated, truncated, _ = env.step(law(observation))
    print(f"the box is at y = {observation['box'][1]:.3f} m, reward {reward:.3f}, solved: {terminated}")


if __name__ == "__main__":
    main()

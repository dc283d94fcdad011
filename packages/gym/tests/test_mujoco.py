"""An environment among bodies in MuJoCo."""

from __future__ import annotations

import importlib.util

import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import urlink
from packages.gym.tests.test_tasks import example

if importlib.util.find_spec("urlink_mujoco") is None:
    pytest.skip("urlink-mujoco is not installed", allow_module_level=True)


def test_env_with_bodies_passes_gymnasiums_check() -> None:
    push = example("push_box")
    with urlink.simulated_time(seed=1), push.make() as env:
        check_env(env.unwrapped, skip_render_check=True)


def test_arm_pushes_box_to_its_goal() -> None:
    push = example("push_box")
    with urlink.simulated_time(seed=1), push.make() as env:
        observation, _ = env.reset(seed=3)
        begin = observation["box"]
        for _ in range(env.spec.max_episode_steps):
            observation, reward, terminated, truncated, info = env.step(push.law(observation))
            if terminated or truncated:
                break
        assert terminated, info
        assert reward > -push.TOLERANCE
        assert np.linalg.norm(observation["box"] - begin) > 0.05
        again, _ = env.reset()
        assert again["box"] == pytest.approx(begin, abs=1e-3)

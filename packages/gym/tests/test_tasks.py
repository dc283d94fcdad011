"""The task `Reach`, and the example that learns it in simulated time."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

import urlink
from packages.gym.tests.conftest import CB3, E_SERIES
from urlink import BadValue
from urlink_gym import ArmEnv, Reach

EXAMPLES = Path(__file__).parents[1] / "examples"


def example(name: str) -> ModuleType:
    """Import an example by its path."""
    spec = importlib.util.spec_from_file_location(name, EXAMPLES / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_reach_rewards_short_distance(make: Callable[..., ArmEnv]) -> None:
    task = Reach(((-0.5, -0.1, 0.3), (-0.4, 0.0, 0.4)), tolerance=0.05)
    env = make(CB3, task=task)
    observation, _ = env.reset(seed=5)
    assert (observation["goal"] >= np.array([-0.5, -0.1, 0.3], np.float32)).all()
    assert (observation["goal"] <= np.array([-0.4, 0.0, 0.4], np.float32)).all()
    for away, solved in (([0.0, 0.03, 0.0], True), ([0.0, 0.06, 0.0], False)):
        reward, terminated = task.judge(env, {"tool_position": task.goal + np.array(away)})
        assert reward == pytest.approx(-away[1], abs=1e-5)
        assert terminated is solved


@pytest.mark.parametrize(
    "wrong",
    [
        {"box": 7},
        {"box": ((0, 0, 0),)},
        {"box": ((1, 0, 0), (0, 1, 1))},
        {"box": ((0, 0, 0), (1, 1, np.nan))},
        {"tolerance": 0.0},
        {"tolerance": np.nan},
    ],
    ids=str,
)
def test_reach_rejects_invalid_arguments(wrong: dict[str, Any]) -> None:
    with pytest.raises(BadValue, match=next(iter(wrong))):
        Reach(**wrong)


def test_policy_trained_on_one_arm_runs_on_another() -> None:
    train = example("train_reach")
    with urlink.simulated_time(seed=1), train.make(CB3) as env:
        policy = train.fit(*train.demonstrate(env, episodes=4))
    with urlink.simulated_time(seed=2), train.make(E_SERIES) as env:
        assert train.solved(env, lambda observation: np.zeros(3), 3, seed=50) == 0
        assert train.solved(env, policy, 3, seed=50) == 3

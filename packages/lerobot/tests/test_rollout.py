"""LeRobot's own program for rollouts: a policy that is fitted to a demonstration pushes a box in MuJoCo."""

from __future__ import annotations

import signal
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

pytest.importorskip("lerobot.rollout", reason="this LeRobot has no rollouts")
pytest.importorskip("urlink_mujoco", reason="urlink-mujoco is not installed")

from lerobot.configs import PreTrainedConfig
from lerobot.configs.types import FeatureType, PolicyFeature
from lerobot.policies.pretrained import PreTrainedPolicy
from lerobot.processor import DeviceProcessorStep, PolicyProcessorPipeline, RenameObservationsProcessorStep
from lerobot.rollout import RolloutConfig
from lerobot.scripts import lerobot_rollout as rollout_script

import urlink
from lerobot_robot_urlink import UR, URConfig
from packages.lerobot.tests.policies import UntrainedConfig
from packages.mujoco.tests.placing import DOWN, TCP, arm_at
from urlink.arm.kinematics import Arm
from urlink_mujoco import MujocoWorld

#: A box of 2 kg on a table. Its near face is at y = 0.15.
PUSH = Path(__file__).parents[2] / "mujoco" / "tests" / "push.xml"
BEFORE, BEHIND = (-0.45, 0.12, 0.05), (-0.45, 0.25, 0.05)
FPS = 20
POSITIONS = [f"joint_{number}.pos" for number in range(1, 7)]


@PreTrainedConfig.register_subclass("linear")
@dataclass
class LinearConfig(UntrainedConfig):
    """Configuration of a policy: its action is a matrix times the joint positions, plus an offset."""


class LinearPolicy(PreTrainedPolicy):
    """Policy that LeRobot finds by the name of its configuration."""

    config_class = LinearConfig
    name = "linear"

    def __init__(self, config: LinearConfig, **options: Any) -> None:
        super().__init__(config)
        self.map = torch.nn.Linear(6, 6)

    def fit(self, states: list[list[float]], actions: list[list[float]]) -> None:
        """Fit the map by least squares with minimum norm.

        Away from the demonstrated path, the map then leads back to it.
        """
        seen, done = torch.tensor(states, dtype=torch.float64)[:, :6], torch.tensor(actions, dtype=torch.float64)
        middle = seen.mean(0)
        weights = torch.linalg.pinv(seen - middle, rtol=1e-3) @ (done - done.mean(0))
        with torch.no_grad():
            self.map.weight.copy_(weights.T)
            self.map.bias.copy_(done.mean(0) - middle @ weights)

    def select_action(self, batch: dict[str, torch.Tensor], **options: Any) -> torch.Tensor:
        chosen: torch.Tensor = self.map(batch["observation.state"][:, :6])
        return chosen

    def predict_action_chunk(self, batch: dict[str, torch.Tensor], **options: Any) -> torch.Tensor:
        return self.select_action(batch).unsqueeze(1)

    def forward(self, batch: dict[str, torch.Tensor]) -> tuple[torch.Tensor, None]:
        raise NotImplementedError

    def get_optim_params(self) -> dict[str, Any]:
        return {}

    def reset(self) -> None:
        return None


@pytest.fixture
def signals() -> Iterator[None]:
    """Restore the signal handlers, which LeRobot's program replaces."""
    taken = signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT
    kept = {number: signal.getsignal(number) for number in taken}
    yield
    for number, handler in kept.items():
        signal.signal(number, handler)


def demonstration(config: URConfig) -> tuple[list[list[float]], list[list[float]]]:
    """Move to a point behind the position of the box; return observations and actions."""
    states: list[list[float]] = []
    actions: list[list[float]] = []
    end = time.monotonic() + 60.0
    arm = UR(config)
    arm.connect()
    try:
        while time.monotonic() < end:
            observation = arm.get_observation()
            here = np.array([observation[name] for name in POSITIONS])
            goal = Arm("UR5e").inverse([*BEHIND, *DOWN], tcp=TCP, near=here)
            if np.abs(goal - here).max() < 2e-3:
                return states, actions
            action = here + 0.1 * (goal - here)
            states.append([observation[name] for name in arm.observation_features])
            actions.append(action.tolist())
            arm.send_action(dict(zip(POSITIONS, action.tolist(), strict=True)))
            time.sleep(1 / FPS)
    finally:
        arm.disconnect()
    raise AssertionError("the arm did not reach its goal")


def saved(states: list[list[float]], actions: list[list[float]], folder: Path) -> LinearConfig:
    """Save a policy that repeats the demonstration, and its processors, like training does."""
    config = LinearConfig(
        input_features={"observation.state": PolicyFeature(FeatureType.STATE, (12,))},
        output_features={"action": PolicyFeature(FeatureType.ACTION, (6,))},
        device="cpu",
    )
    policy = LinearPolicy(config)
    policy.fit(states, actions)
    policy.save_pretrained(folder)
    device = DeviceProcessorStep(device="cpu")
    steps = [RenameObservationsProcessorStep(rename_map={}), device]
    PolicyProcessorPipeline(steps=steps, name="policy_preprocessor").save_pretrained(folder)
    PolicyProcessorPipeline(steps=[device], name="policy_postprocessor").save_pretrained(folder)
    config.pretrained_path = folder
    return config


@pytest.mark.usefixtures("signals")
def test_fitted_policy_pushes_box_like_demonstration(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HF_HUB_OFFLINE", "1")
    controller = arm_at(BEFORE)
    world = MujocoWorld(PUSH, {"left": controller})
    start = list(controller.arm.setpoint.q)
    with controller:
        config = URConfig(
            id="arm",
            calibration_dir=tmp_path / "none",
            address=controller.address,
            fps=FPS,
            # below 0.1 m/s, because the box would otherwise slide on after the arm has stopped
            max_step=0.01,
            watchdog=5.0,
            observe_tool=False,
        )
        states, actions = demonstration(config)
        shown = world.pose("box")
        assert shown[1] > 0.25
        with urlink.connect(controller.address) as robot:
            robot.motion.move_joints(start, wait=True)
        world.reset()
        assert world.pose("box")[1] == pytest.approx(0.2, abs=1e-3)
        rollout_script.rollout(
            RolloutConfig(
                robot=config,
                policy=saved(states, actions, tmp_path / "policy"),
                fps=FPS,
                duration=12.0,
                task="push",
                return_to_initial_position=False,
                play_sounds=False,
            )
        )
    assert world.pose("box")[:2] == pytest.approx(shown[:2], abs=0.01)

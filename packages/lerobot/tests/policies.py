"""Small policies that LeRobot finds by the names of their configurations, and their saved form."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import torch
from lerobot.configs.policies import PreTrainedConfig
from lerobot.configs.types import FeatureType, PolicyFeature
from lerobot.policies.pretrained import PreTrainedPolicy
from lerobot.policies.rtc.configuration_rtc import RTCConfig
from lerobot.policies.rtc.modeling_rtc import RTCProcessor
from lerobot.processor import DeviceProcessorStep, PolicyProcessorPipeline, RenameObservationsProcessorStep

#: Number of actions of a chunk, and by how much each action turns wrist 3, in rad.
HORIZON, STEP = 40, 0.01


@dataclass
class UntrainedConfig(PreTrainedConfig):
    """Configuration of a policy that LeRobot does not train."""

    observation_delta_indices = action_delta_indices = reward_delta_indices = None

    def get_optimizer_preset(self) -> Any:
        raise NotImplementedError

    def get_scheduler_preset(self) -> None:
        return None

    def validate_features(self) -> None:
        return None


@PreTrainedConfig.register_subclass("steady")
@dataclass
class SteadyConfig(UntrainedConfig):
    """Configuration of a policy that turns wrist 3 steadily. `seconds` is its computing time."""

    seconds: float = 0.1

    #: parameters of real-time chunking; not a field, because they are not saved
    rtc_config = None


class SteadyPolicy(PreTrainedPolicy):
    """Policy whose chunks are denoised in five steps, like those of a flow-matching policy.

    Each chunk has another offset, so that two chunks never agree without real-time chunking.

    Attributes:
        calls: Arguments and results of `predict_action_chunk`.
        stalls: Additional computing times of the next calls, in s.
    """

    config_class = SteadyConfig
    name = "steady"
    calls: ClassVar[list[dict[str, Any]]] = []
    stalls: ClassVar[list[float]] = []

    def __init__(self, config: SteadyConfig, **options: Any) -> None:
        super().__init__(config)
        self.map = torch.nn.Linear(6, 6)
        rtc: RTCConfig | None = config.rtc_config
        self.rtc = RTCProcessor(rtc) if rtc is not None and rtc.enabled else None

    def predict_action_chunk(
        self,
        batch: dict[str, torch.Tensor],
        inference_delay: int = 0,
        prev_chunk_left_over: torch.Tensor | None = None,
        **options: Any,
    ) -> torch.Tensor:
        time.sleep(self.config.seconds + (self.stalls.pop(0) if self.stalls else 0.0))
        here = batch["observation.state"][0, :6]
        clean = here.repeat(HORIZON, 1)
        clean[:, 5] += STEP * torch.arange(HORIZON) + 0.02 * (-1) ** len(self.calls)
        x = torch.zeros(1, HORIZON, 6)
        for step in range(5):
            t = 1.0 - step / 5

            def velocity(x_t: torch.Tensor, t: float = t) -> torch.Tensor:
                return (x_t - clean) / t

            if self.rtc is None:
                v = velocity(x)
            else:
                v = self.rtc.denoise_step(x, prev_chunk_left_over, inference_delay, t, velocity)
            x = (x - v / 5).detach()
        self.calls.append({"delay": inference_delay, "left": prev_chunk_left_over, "clean": clean, "chunk": x[0]})
        return x

    def select_action(self, batch: dict[str, torch.Tensor], **options: Any) -> torch.Tensor:
        return self.predict_action_chunk(batch)[:, 0]

    def forward(self, batch: dict[str, torch.Tensor]) -> tuple[torch.Tensor, None]:
        raise NotImplementedError

    def get_optim_params(self) -> dict[str, Any]:
        return {}

    def reset(self) -> None:
        return None


def saved_policy(folder: Path, size: int, **options: Any) -> Path:
    """Save the policy and its processors, like training does.

    Args:
        folder: Folder of the policy.
        size: Size of the state of the robot.
        options: See `SteadyConfig`.
    """
    config = SteadyConfig(
        input_features={"observation.state": PolicyFeature(FeatureType.STATE, (size,))},
        output_features={"action": PolicyFeature(FeatureType.ACTION, (6,))},
        device="cpu",
        **options,
    )
    SteadyPolicy(config).save_pretrained(folder)
    device = DeviceProcessorStep(device="cpu")
    steps = [RenameObservationsProcessorStep(rename_map={}), device]
    PolicyProcessorPipeline(steps=steps, name="policy_preprocessor").save_pretrained(folder)
    PolicyProcessorPipeline(steps=[device], name="policy_postprocessor").save_pretrained(folder)
    return folder

"""Run a policy with LeRobot's real-time chunking (RTC) on an arm.

The policy computes the next chunk while the arm executes the previous one. It gets the number of actions that the arm
takes meanwhile, from LeRobot's `LatencyTracker`, and the rest of the previous chunk. The arm executes exactly these
actions, and then changes to the new chunk with continuous speed and acceleration.

The policy must support RTC: in LeRobot 0.4.4 pi0, pi05, and smolvla.

python packages/lerobot/examples/real_time_chunking.py sim:// user/my_smolvla --task "pick up the cube"
python packages/lerobot/examples/real_time_chunking.py 192.168.56.101 user/my_smolvla --limits lab.json  # THE ARM MOVES
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable
from typing import Any

import torch
from lerobot.async_inference.helpers import map_robot_keys_to_lerobot_features
from lerobot.configs.policies import PreTrainedConfig
from lerobot.policies.factory import get_policy_class, make_pre_post_processors
from lerobot.policies.rtc.configuration_rtc import RTCConfig
from lerobot.policies.rtc.latency_tracker import LatencyTracker
from lerobot.policies.utils import build_inference_frame

from lerobot_robot_urlink import UR, URConfig
from linkcore import clock

#: Number of latencies that count, and the time in s that the points need to reach the robot.
REMEMBERED, SENDING = 20, 0.03


def run(
    robot: UR,
    policy: Any,
    prepare: Callable[[dict[str, Any]], dict[str, Any]],
    finish: Callable[[torch.Tensor], torch.Tensor],
    *,
    period: float,
    duration: float,
) -> LatencyTracker:
    """Execute chunks of a policy with RTC.

    Args:
        robot: Connected robot.
        policy: Policy whose `predict_action_chunk` takes `inference_delay` and `prev_chunk_left_over`.
        prepare: Function that converts an observation of the robot to a batch for the policy.
        finish: Function that converts actions of the policy, shape (1, n), to actions of the robot.
        period: Time between two actions, in s.
        duration: Duration, in s.

    Returns:
        The measured latencies.
    """
    names = list(robot.action_features)
    latency = LatencyTracker(maxlen=REMEMBERED)
    previous: torch.Tensor | None = None
    end = clock.now() + duration
    while (began := clock.now()) < end:
        observation = robot.get_observation()
        left, frozen = None, 0
        if previous is not None:
            # Without the actions that the arm has executed until this observation.
            left = previous[round(robot.chunk_time / period) :]
            frozen = max(min(math.ceil((latency.p95() + SENDING) / period), len(left) - 2), 0)
        chunk = policy.predict_action_chunk(prepare(observation), inference_delay=frozen, prev_chunk_left_over=left)[0]
        actions = [dict(zip(names, finish(row[None])[0].tolist(), strict=True)) for row in chunk]
        robot.send_chunk(actions, period, frozen=min(frozen, len(actions) - 2))
        latency.add(clock.now() - began)
        previous = chunk
    return latency


def arguments(words: list[str] | None = None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("address")
    parser.add_argument("policy", help="folder or name of a trained policy")
    parser.add_argument("--task", default="", help="instruction for the policy")
    parser.add_argument("--fps", type=float, default=30.0, help="actions per second of the data set (default: 30)")
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--limits", default="", help="JSON file of urlink.SessionLimits, or 'teaching'")
    parser.add_argument("--device", default="cpu")
    args = parser.parse_args(words)
    if not args.limits and not args.address.startswith("sim://"):
        parser.error("pass --limits for a real arm, because a policy chooses motions on its own")
    return args


def main(words: list[str] | None = None) -> None:
    args = arguments(words)
    config = PreTrainedConfig.from_pretrained(args.policy)
    config.rtc_config = RTCConfig(enabled=True)
    policy = get_policy_class(config.type).from_pretrained(args.policy, config=config).to(args.device)
    before, after = make_pre_post_processors(
        config, pretrained_path=args.policy, preprocessor_overrides={"device_processor": {"device": args.device}}
    )
    # A long watchdog: the robot brakes at once if this process ends, and at the end of each chunk.
    robot = UR(URConfig(address=args.address, fps=args.fps, limits=args.limits, watchdog=2.0))
    features = map_robot_keys_to_lerobot_features(robot)

    def prepare(observation: dict[str, Any]) -> dict[str, Any]:
        frame = build_inference_frame(observation, torch.device(args.device), features, args.task, robot.name)
        batch: dict[str, Any] = before(frame)
        return batch

    robot.connect()
    try:
        latency = run(robot, policy, prepare, after, period=1.0 / args.fps, duration=args.seconds)
    finally:
        robot.disconnect()
    print(f"latency up to {latency.max():.2f} s")


if __name__ == "__main__":
    main()

"""Train a policy in simulated time, and run it on an arm, with the same class.

The tool has to reach a random position. A simple law demonstrates the task in the simulator, with random disturbances.
A linear policy is fitted to the demonstrations with least squares. It then runs on the arm in real time.

python packages/gym/examples/train_reach.py                                    # the simulator
python packages/gym/examples/train_reach.py 192.168.56.101 --limits lab.json   # THE ARM MOVES
"""

import argparse
from collections.abc import Callable
from typing import Any

import gymnasium
import numpy as np

import urlink
import urlink_gym

#: Address of the arm for the demonstrations; a CB3 has the fewest cycles per second.
TRAINING = "sim://ur5?firmware=3.15"
#: Fraction of the remaining distance by which the demonstration moves the target in a step.
GAIN = 0.15


def make(address: str, limits: urlink.SessionLimits | None = None) -> gymnasium.Env[Any, Any]:
    """Return the environment: a step moves the target of the tool by up to 10 mm along each axis."""
    steps = urlink_gym.Steps(move=0.01)
    return gymnasium.make("urlink/Reach-v0", robot=address, limits=limits, steps=steps, max_episode_steps=100)


def features(observation: dict[str, np.ndarray]) -> np.ndarray:
    return np.concatenate((observation["tool_position"], observation["goal"], [1.0]))


def demonstrate(env: gymnasium.Env[Any, Any], episodes: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the features and the actions of some episodes."""
    seen, done = [], []
    for episode in range(episodes):
        observation, _ = env.reset(seed=episode)
        is_over = False
        while not is_over:
            away = observation["goal"] - observation["tool_position"]
            action = np.clip(GAIN * away / 0.01, -1.0, 1.0)
            # Large distances are clipped, and would spoil the fit.
            if np.abs(action).max() < 1.0:
                seen.append(features(observation))
                done.append(action)
            noise = env.np_random.normal(0.0, 0.3, 3)
            observation, _, terminated, truncated, _ = env.step(action + noise)
            is_over = terminated or truncated
    return np.array(seen), np.array(done)


def fit(seen: np.ndarray, done: np.ndarray) -> Callable[[dict[str, np.ndarray]], np.ndarray]:
    """Return the linear policy that repeats the demonstrations best."""
    weights, *_ = np.linalg.lstsq(seen, done, rcond=None)
    return lambda observation: np.clip(features(observation) @ weights, -1.0, 1.0)


def solved(
    env: gymnasium.Env[Any, Any], policy: Callable[[dict[str, np.ndarray]], np.ndarray], episodes: int, seed: int
) -> int:
    """Return how many episodes the policy solves."""
    count = 0
    for episode in range(episodes):
        observation, _ = env.reset(seed=seed + episode)
        terminated = truncated = False
        while not (terminated or truncated):
            observation, _, terminated, truncated, info = env.step(policy(observation))
        if "error" in info:
            raise SystemExit(f"the episode ended: {info['error']}")
        count += terminated
    return count


def main() -> None:
    parser = argparse.ArgumentParser(description="Train a policy in simulated time, and run it on an arm.")
    parser.add_argument("address", nargs="?", default="sim://ur5e", help="robot or simulator (default: sim://ur5e)")
    parser.add_argument("--limits", help="JSON file of urlink.SessionLimits, or 'teaching'; required for a real arm")
    parser.add_argument("--episodes", type=int, default=3, help="episodes on the arm (default: 3)")
    args = parser.parse_args()
    limits = None if args.limits is None else urlink.SessionLimits.named(args.limits)
    with urlink.simulated_time(seed=1), make(TRAINING) as env:
        seen, done = demonstrate(env, episodes=8)
    print(f"fitted {len(seen)} steps of 8 demonstrations")
    policy = fit(seen, done)
    with make(args.address, limits) as env:
        print(f"solved {solved(env, policy, args.episodes, seed=100)} of {args.episodes} episodes")


if __name__ == "__main__":
    main()

"""Benchmark: processor time of a step of `ArmEnv`, compared with the same calls without the environment.

Both loops run in turns on one simulated arm in this process. Each turn of the loop without the environment computes the
target of the joints, sends it, waits for the end of the period, takes the states that have arrived, and packs the
observation. The figures are processor times of the calling thread. So they contain neither the simulator nor the wait.

    python packages/gym/tests/benchmark.py
    python packages/gym/tests/benchmark.py --quick
    python packages/gym/tests/benchmark.py --json      # prints one JSON object
"""

from __future__ import annotations

import argparse
import json
import statistics
import time
from collections import deque
from typing import Any

import numpy as np

import urlink
from linkcore import clock
from urlink.arm import poses
from urlink.packets import RealtimeState
from urlink.tools import shown_tcp
from urlink_gym import ArmEnv, Reach
from urlink_gym.arm_env import HOME

#: Period of the loops, and a long watchdog, because a busy machine delays the simulated robot, in s.
PERIOD, WATCHDOG = 0.05, 2.0
LIMITS = urlink.SessionLimits(tool_speed=1.0, box=((-0.9, -0.9, 0.02), (0.9, 0.9, 1.2)))


def wave(i: int) -> np.ndarray[tuple[int], np.dtype[np.float32]]:
    """Return an action; the tool moves along a small figure."""
    return np.array([np.sin(0.3 * i), np.cos(0.3 * i), np.sin(0.15 * i), 0.0, 0.0, np.sin(0.2 * i)], np.float32)


def with_env(robot: urlink.Robot, count: int) -> float:
    """Return the median processor time of a step of the environment, in s."""
    env = ArmEnv(robot, rate=1.0 / PERIOD, task=Reach(), watchdog=WATCHDOG)
    env.reset(seed=1)
    spent = []
    for i in range(count):
        begin = time.thread_time()
        env.step(wave(i))
        spent.append(time.thread_time() - begin)
    env.close()
    return statistics.median(spent)


def without_env(robot: urlink.Robot, count: int) -> float:
    """Return the median processor time of the same calls without the environment, in s."""
    robot.motion.move_joints(HOME, speed=0.8, wait=True)
    arm, goal, scale = robot.kinematics, np.zeros(3, np.float32), np.array([0.01] * 3 + [0.05] * 3)
    arrived: deque[RealtimeState] = deque(maxlen=10_000)
    options: Any = {"speed": 1.05, "acceleration": 5.0, "jerk": 50.0, "watchdog": WATCHDOG}
    with robot.motion.servo(1.0 / PERIOD, target_filter="jerk_limited", **options) as servo:
        subscription = robot.realtime.subscribe(arrived.append, inline=True)
        state = robot.realtime.wait()
        q, tcp = state.q_target, shown_tcp(arm, state)
        servo.send(q)
        tick = clock.now()
        spent = []
        for i in range(count):
            begin = time.thread_time()
            tick = max(tick, clock.now() - PERIOD)
            action = np.clip(np.asarray(wave(i), np.float64), -1.0, 1.0)
            pose, change = arm.forward(q, tcp), scale * action
            turned = poses.compose((0.0, 0.0, 0.0, *change[3:]), (0.0, 0.0, 0.0, *pose[3:]))[3:]
            q = arm.inverse(np.concatenate((pose[:3] + change[:3], turned)), q, tcp)
            servo.send(q)
            tick += PERIOD
            clock.sleep(tick - clock.now())
            states = [arrived.popleft() for _ in range(len(arrived))] or [robot.realtime.wait()]
            state = states[-1]
            pose = state.tool_vector_actual
            matrix = poses.rotvec_to_matrix(pose[3:])
            observation = {
                "q_actual": state.q_actual.astype(np.float32),
                "qd_actual": state.qd_actual.astype(np.float32),
                "tool_position": pose[:3].astype(np.float32),
                "tool_rotation": np.concatenate((matrix[:, 0], matrix[:, 1])).astype(np.float32),
                "goal": goal.copy(),
            }
            -np.linalg.norm(observation["tool_position"] - goal)
            spent.append(time.thread_time() - begin)
        subscription.close()
    return statistics.median(spent)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="run a quarter of the steps")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    options = parser.parse_args()
    turns, count = (3, 60) if options.quick else (6, 120)
    found = {}
    for name, limits in (("without limits", None), ("with limits", LIMITS)):
        with urlink.connect("sim://ur5e?firmware=5.11", limits=limits, silence=20.0, stale_after=20.0) as robot:
            pairs = [(with_env(robot, count), without_env(robot, count)) for _ in range(turns)]
        found[name] = {
            "step_us": statistics.median(one for one, _ in pairs) * 1e6,
            "calls_us": statistics.median(other for _, other in pairs) * 1e6,
            "ratio": statistics.median(one / other for one, other in pairs),
        }
    if options.json:
        print(json.dumps(found))
        return
    for name, row in found.items():
        print(
            f"{name}: step {row['step_us']:.0f} us, the same calls {row['calls_us']:.0f} us, ratio {row['ratio']:.2f}"
        )


if __name__ == "__main__":
    main()

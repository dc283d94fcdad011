"""Follow chunks of motion from a policy that needs computing time, as learned policies do.

The policy reads the state of the arm, computes for a while, and returns the positions of the next 1.5 s. By then, the
arm has moved on. So a chunk starts in the past, and replaces the rest of the previous chunk. The arm changes from one
chunk to the next without a jolt, and brakes if a chunk arrives too late.

python examples/policy_chunks.py                       # the simulator
python examples/policy_chunks.py 192.168.56.101
"""

import argparse
import math
import random
import time

import numpy as np

import urlink

HOME = (0.0, -1.57, 1.57, -1.57, -1.57, 0.0)
#: Time between two positions of a chunk, in s; number of positions; shortest and longest computing time, in s.
PERIOD, HORIZON, QUICKEST, SLOWEST = 0.05, 30, 0.05, 0.6


def policy(observed: np.ndarray, t: float, luck: random.Random) -> urlink.Trajectory:
    """Return the next joint positions. Your policy uses images; this one waves randomly."""
    time.sleep(luck.uniform(QUICKEST, SLOWEST))
    off = luck.uniform(-0.003, 0.003)
    times = PERIOD * np.arange(HORIZON)
    turns = 0.2 * np.sin(0.5 * math.pi * (t + times)) ** 2 + off
    return urlink.Trajectory.from_arrays(times, np.array(HOME) + turns[:, None] * [0.5, 0, 0, 0, 0, 1.0])


def main() -> None:
    parser = argparse.ArgumentParser(description="Follow chunks of a policy.")
    parser.add_argument("address", nargs="?", default="sim://", help="robot or simulator (default: sim://)")
    parser.add_argument("--duration", type=float, default=3.0, help="duration, s (default: 3)")
    args = parser.parse_args()
    luck = random.Random(1)
    chunks = 0
    with urlink.connect(args.address) as robot:
        robot.motion.move_joints(HOME, speed=0.5, wait=120.0)
        with robot.motion.stream() as stream:
            while stream.time < args.duration:
                looked, observed = stream.time, robot.realtime.wait().q_actual
                stream.replace(looked, policy(observed, looked, luck))
                chunks += 1
            stream.clear()
            stream.wait_until_dry()
            starved = stream.starved
    print(f"{chunks} chunks in {args.duration:g} s, starved {starved} times")


if __name__ == "__main__":
    main()

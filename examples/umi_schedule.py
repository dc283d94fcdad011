"""Schedule waypoints with times, as the interpolation controller of UMI and diffusion_policy receives them.

A policy uses the past motion of the arm, and returns several future poses of the tool with their times. They are sent
ahead of time, with times of the robot's clock. A pose that arrives too late is left out.

python examples/umi_schedule.py                       # the simulator
python examples/umi_schedule.py 192.168.56.101
"""

import argparse
import math

import numpy as np

import urlink

HOME = (0.0, -1.57, 1.57, -1.57, -1.57, 0.0)
#: Time between two poses of the policy, in s; number of poses per call; number of poses until the next call.
PERIOD, HORIZON, STEPS = 0.1, 8, 4


def policy(home: np.ndarray, t: float) -> np.ndarray:
    """Return the wanted pose of the tool, on a circle of 3 cm. Your policy uses images."""
    turn = 0.5 * math.pi * t
    return home + np.array([0.03 * math.sin(turn), 0.03 * (1.0 - math.cos(turn)), 0.0, 0.0, 0.0, 0.0])


def main() -> None:
    parser = argparse.ArgumentParser(description="Follow a policy's waypoints.")
    parser.add_argument("address", nargs="?", default="sim://", help="robot or simulator (default: sim://)")
    parser.add_argument("--duration", type=float, default=2.0, help="duration, s (default: 2)")
    args = parser.parse_args()
    scheduled = left_out = 0
    with urlink.connect(args.address) as robot:
        robot.motion.move_joints(HOME, speed=0.5, wait=120.0)
        with robot.realtime.history(0.1) as history, robot.motion.servo(lookahead_time=0.1, watchdog=0.5) as servo:
            state = robot.realtime.wait()
            home, begun = state.tool_vector_actual.copy(), state.time
            while (t := state.time - begun) < args.duration:
                observed = history.array("time", "q_actual", "tool_vector_actual")  # for the policy
                for step in range(1, HORIZON + 1):
                    pose = policy(home, t + step * PERIOD)
                    reached = servo.schedule(urlink.Linear(pose), at=state.time + step * PERIOD)
                    scheduled, left_out = scheduled + 1, left_out + (reached is None)
                again = state.time + STEPS * PERIOD
                state = robot.realtime.wait_until(lambda state, again=again: state.time >= again, timeout=10.0)
        # The past states for a policy, shape (n,): time, q_actual, tool_vector_actual, ...
        observed = robot.realtime.history(0.1)
    print(f"{scheduled} poses scheduled, {left_out} of them too late; {len(observed)} states seen at last")


if __name__ == "__main__":
    main()

"""Follow a trajectory from a CSV file, and tell how far the arm was from it.

The file has the header time,q0,...,q5 and, or not, qd0,...,qd5 and qdd0,...,qdd5; s and rad. Without a file it is a
little wave of the tool joint. The arm goes to the first point slowly before it follows.

    python examples/follow_csv.py                                  # the simulator
    python examples/follow_csv.py --file wave.csv 192.168.56.101
    python examples/follow_csv.py --low-bandwidth                  # the robot interpolates by itself
"""

import argparse
import sys

import numpy as np

import urlink
from urlink import Trajectory
from urlink.motion import TrajectoryFeedback

HOME = (0.0, -1.57, 1.57, -1.57, -1.57, 0.0)


def wave() -> Trajectory:
    time = np.linspace(0.0, 1.0, 11)
    q = np.tile(HOME, (len(time), 1))
    q[:, 5] += 0.1 * (1.0 - np.cos(2.0 * np.pi * time))
    return Trajectory.from_arrays(time, q)


def main() -> int:
    parser = argparse.ArgumentParser(description="Follow a trajectory.")
    parser.add_argument("address", nargs="?", default="sim://", help="robot or simulator (sim://)")
    parser.add_argument("--file", help="the trajectory as CSV")
    parser.add_argument("--low-bandwidth", action="store_true", help="hand it over point by point")
    parser.add_argument("--path-tolerance", type=float, help="rad off the path that end it")
    args = parser.parse_args()

    worst = np.zeros(6)

    def feedback(now: TrajectoryFeedback) -> None:
        np.maximum(worst, np.abs(now.error), out=worst)

    try:
        trajectory = wave() if args.file is None else Trajectory.from_csv(args.file)
        with urlink.connect(args.address) as robot:
            robot.motion.move_joints(trajectory.q[0], speed=0.3).wait(timeout=120)
            motion = robot.motion.follow(
                trajectory,
                low_bandwidth=args.low_bandwidth,
                path_tolerance=args.path_tolerance,
                feedback=feedback,
            )
            motion.wait(timeout=trajectory.duration + 20)
    except urlink.LinkError as error:
        print(f"{type(error).__name__}: {error}", file=sys.stderr)
        return 1
    print(f"followed {len(trajectory)} points in {trajectory.duration:g} s")
    print("furthest from the path, rad:", " ".join(f"{each:.4f}" for each in worst))
    return 0


if __name__ == "__main__":
    sys.exit(main())

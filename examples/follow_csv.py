"""Follow a trajectory from a CSV file, and print the largest deviation of the arm from it.

The file has the header time,q0,...,q5 and, optionally, qd0,...,qd5 and qdd0,...,qdd5, in s and rad. Without a file, the
trajectory is a small wave of the tool joint. The arm first moves slowly to the first point.

    python examples/follow_csv.py                                  # the simulator
    python examples/follow_csv.py --file wave.csv 192.168.56.101
    python examples/follow_csv.py --low-bandwidth                  # the robot interpolates on its own
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
    parser.add_argument("address", nargs="?", default="sim://", help="robot or simulator (default: sim://)")
    parser.add_argument("--file", help="CSV file of the trajectory")
    parser.add_argument("--low-bandwidth", action="store_true", help="send the trajectory point by point")
    parser.add_argument("--path-tolerance", type=float, help="maximum deviation from the path, rad")
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
    print("largest deviation from the path, rad:", " ".join(f"{each:.4f}" for each in worst))
    return 0


if __name__ == "__main__":
    sys.exit(main())

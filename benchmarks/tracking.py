"""Tracking experiment of the original driver: whether the arm does the same each time.

The tool joint, wrist 3, moves to 0 rad in 1 s, to 1 rad in 3 s and back in 4 s, four times. `robot.motion.follow`
streams this in real time to simulated controllers of both rates, each in a separate process. All times are those of the
controller.

    python benchmarks/tracking.py                     # four runs at 125 and at 500 Hz
    python benchmarks/tracking.py --link rtde         # over input registers, with 3.15, 5.4 and 5.11
    python benchmarks/tracking.py --output FILE       # writes the curves that the docs show
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np
from _simulated import simulated
from numpy.typing import NDArray

import urlink
from urlink.motion import TrajectoryFeedback
from urlink.motion.motions import LinkName

#: Arms for each link, over which set-points are sent.
ARMS: dict[LinkName, tuple[tuple[str, str], ...]] = {
    "reverse": (("UR5", "3.4"), ("UR5e", "5.11")),
    "rtde": (("UR5", "3.15"), ("UR5e", "5.4"), ("UR5e", "5.11")),
}
JOINT = 5
#: Start position, in rad: elbow up, tool down, and the tool joint away from its first goal.
START = (0.0, -1.6, 1.6, -1.6, -1.6, 0.25)
#: Time, in s, and position of the tool joint, in rad.
COURSE = ((0.0, START[JOINT]), (1.0, 0.0), (4.0, 1.0), (8.0, 0.0))
#: Largest allowed difference between two runs, in rad; with the original driver, it was 0.03.
GOAL = 0.005
#: Points per second in the file.
DRAWN = 10

FloatArray = NDArray[np.float64]


def run(robot: urlink.Robot, rate: int, pace: float, link: LinkName) -> dict[int, tuple[float, float, float]]:
    """Return values of the tool joint, by cycle since the start.

    The values are desired position (rad), desired speed (rad/s) and actual position (rad).
    """
    robot.motion.move_joints(START).wait()
    here = robot.realtime.wait(5).q_target
    q = np.tile(here, (len(COURSE), 1))
    q[1:, JOINT] = [position for _, position in COURSE[1:]]
    trajectory = urlink.Trajectory.from_arrays([time / pace for time, _ in COURSE], q)
    seen: dict[int, tuple[float, float, float]] = {}

    def note(told: TrajectoryFeedback) -> None:
        desired, speed, actual = told.q_desired[JOINT], told.qd_desired[JOINT], told.q_actual[JOINT]
        seen[round(told.time * rate)] = (float(desired), float(speed), float(actual))

    robot.motion.follow(trajectory, feedback=note, link=link).wait()
    return seen


def measure(model: str, firmware: str, runs: int, pace: float, link: LinkName) -> dict[str, Any]:
    """Return the figures and the curves of one controller."""
    with simulated(model, firmware) as address, urlink.connect(address) as robot:
        assert robot.firmware is not None
        rate = robot.firmware.rate
        seen = [run(robot, rate, pace, link) for _ in range(runs)]
    cycles = sorted(set[int].intersection(*map(set, seen)))
    most = max(len(each) for each in seen)
    desired, speed = (np.array([seen[0][cycle][i] for cycle in cycles]) for i in (0, 1))
    actual = np.array([[each[cycle][2] for cycle in cycles] for each in seen])
    error = actual - desired
    spread = actual.max(axis=0) - actual.min(axis=0)
    # The delay that explains most of the error. To first order, the error is the desired speed times the delay.
    lag = float(-(error @ speed).sum() / (runs * (speed @ speed)))
    time = np.array(cycles) / rate
    beside = error + lag * speed
    return {
        "model": model,
        "firmware": firmware,
        "rate": rate,
        "runs": runs,
        "cycles": len(cycles),
        "cycles_not_seen_in_all": most - len(cycles),
        "largest_error": float(np.abs(error).max()),
        "lag": lag,
        "largest_error_beside_lag": float(np.abs(beside).max()),
        "spread": float(spread.max()),
        "curves": curves(time, desired, actual, spread),
    }


def curves(time: FloatArray, desired: FloatArray, actual: FloatArray, spread: FloatArray) -> dict[str, Any]:
    """Return only as many points as are visible.

    For the spread, return the largest value until the next point.
    """
    slot = (time * DRAWN + 1e-6).astype(int)
    first = np.unique(slot, return_index=True)[1]
    return {
        "time": time[first].round(4).tolist(),
        "desired": desired[first].round(6).tolist(),
        "actual": actual[:, first].round(6).tolist(),
        "spread": np.maximum.reduceat(spread, first).round(6).tolist(),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="two runs at twice the speed")
    parser.add_argument("--output", type=Path, help="write the figures and the curves as JSON")
    parser.add_argument("--link", choices=list(ARMS), default="reverse", help="link over which set-points are sent")
    options = parser.parse_args()
    runs, pace = (2, 2.0) if options.quick else (4, 1.0)
    print(f"tool joint, {runs} runs          largest error   of that a lag of   other than lag   between runs (goal)")
    found = []
    for model, firmware in ARMS[options.link]:
        figures = measure(model, firmware, runs, pace, options.link)
        found.append(figures)
        name = f"{model} {firmware}, {figures['rate']} Hz"
        print(
            f"  {name:24} {figures['largest_error'] * 1e3:10.2f} mrad {figures['lag'] * 1e3:14.1f} ms"
            f" {figures['largest_error_beside_lag'] * 1e3:11.2f} mrad {figures['spread'] * 1e3:9.2f} mrad"
            f" (under {GOAL * 1e3:g})"
        )
    if options.output is not None:
        options.output.parent.mkdir(parents=True, exist_ok=True)
        options.output.write_text(json.dumps({"pace": pace, "arms": found}) + "\n")


if __name__ == "__main__":
    main()

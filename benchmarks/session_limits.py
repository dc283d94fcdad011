"""Cost of the watch that keeps an arm within the limits of a session: one check per state while the arm moves.

A jog is checked in each cycle of the controller (`urlink.motion.servo.speed_watch`). For joints, an upper bound of the
motion accepts most states. Close to a limit, samples of the whole motion are compared. The last column is the cost
compared with these samples, in the same process.

    python benchmarks/session_limits.py
    python benchmarks/session_limits.py --quick
"""

import argparse
import time
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np

import urlink
from urlink.motion.servo.following import AHEAD
from urlink.motion.servo.speed_watch import SpeedWatch

#: Cycle of the fastest controllers, in s, and acceleration, in rad/s² or m/s².
CYCLE, ACCELERATION = 0.002, 1.2
LIMITS = urlink.SessionLimits.teaching(box=((-1.5, -1.5, -1.5), (1.5, 1.5, 1.5)))


def seconds(work: Callable[[], object], number: int) -> float:
    """Return the processor time of a call in s, of the best of five runs."""
    best = float("inf")
    for _ in range(5):
        began = time.process_time()
        for _ in range(number):
            work()
        best = min(best, (time.process_time() - began) / number)
    return best


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="run a fifth of the checks")
    number = 100 if parser.parse_args().quick else 500
    with urlink.simulated_time(), urlink.connect("sim://ur5e?firmware=5.11", limits=LIMITS) as robot:
        q = robot.realtime.wait().q_target
        limited = robot.motion._context.limited()
    assert limited is not None
    joints, tool = np.full(6, 0.1), np.array([0.05, 0.02, 0.0, 0.0, 0.0, 0.1])
    limited.qd = joints
    # The arm already moves at the speeds that are checked.
    state: Any = SimpleNamespace(q_target=q, qd_target=joints)
    samples = seconds(lambda: limited.check_joint_speed(joints, ACCELERATION, AHEAD * CYCLE), number)
    print(
        f"{'samples of a motion of the joints':36}{samples * 1e6:6.0f} us {samples / CYCLE:6.1%} of a cycle at 500 Hz"
    )
    for name, speeds, is_tool in (("joints", joints, False), ("tool", tool, True)):
        watch = SpeedWatch(limited, ACCELERATION, is_tool=is_tool)
        cost = seconds(lambda watch=watch, speeds=speeds: watch.check(state, speeds), number)  # type: ignore[misc]
        what = f"watch of a speed of the {name}"
        print(f"{what:36}{cost * 1e6:6.0f} us {cost / CYCLE:6.1%} of a cycle at 500 Hz, {cost / samples:5.2f} times")


if __name__ == "__main__":
    main()

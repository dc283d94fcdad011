"""Cost of a jerk-limited target filter: a new target for all six joints in each cycle, planned and sampled.

python benchmarks/target_filter.py
"""

import argparse
import math
import time

from urlink.motion.servo.jerk_limited import TargetFilter, joint_limits

#: Cycle of the fastest controllers, in s.
CYCLE = 0.002


def measure(cycles: int) -> float:
    """Return the processor time of one cycle, in s."""
    led = TargetFilter([0.0] * 6, joint_limits(None, 1.05, 3.0, 30.0))
    begun = time.process_time()
    for i in range(cycles):
        led.aim([0.3 * math.sin(0.01 * i + joint) for joint in range(6)])
        led.advance(CYCLE)
    return (time.process_time() - begun) / cycles


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="run a fifth of the cycles")
    options = parser.parse_args()
    seconds = min(measure(1000 if options.quick else 5000) for _ in range(3))
    print(f"new targets for six joints: {seconds * 1e6:.0f} us, {seconds / CYCLE:.1%} of a cycle at 500 Hz")


if __name__ == "__main__":
    main()

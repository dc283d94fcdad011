"""Move a follower arm with a leader arm, as with gello: the leader sends only joint positions, at its own pace.

gello calls servoJ in a loop with its own timing. Here, the leader may be slow or uneven, or it may jump, because a
target filter keeps the follower within its limits.

python examples/gello_servo.py                       # the simulator
python examples/gello_servo.py 192.168.56.101
"""

import argparse
import math
import random
import time

import urlink

HOME = (0.0, -1.57, 1.57, -1.57, -1.57, 0.0)


def leader(t: float) -> list[float]:
    """Return the leader's joint positions, in rad. Replace this by reading your leader."""
    wave = 0.2 * math.sin(math.pi * t)
    return [HOME[0] + wave, *HOME[1:5], HOME[5] - wave]


def main() -> None:
    parser = argparse.ArgumentParser(description="Follow a leader arm.")
    parser.add_argument("address", nargs="?", default="sim://", help="robot or simulator (default: sim://)")
    parser.add_argument("--duration", type=float, default=1.5, help="duration, s (default: 1.5)")
    args = parser.parse_args()
    with urlink.connect(args.address) as robot:
        robot.motion.move_joints(HOME, speed=0.5, wait=120.0)
        options = {"speed": 1.5, "acceleration": 8.0, "jerk": 100.0}
        with (
            robot.realtime.history(args.duration) as history,
            robot.motion.servo(rate=50, target_filter="jerk_limited", watchdog=0.5, **options) as servo,
        ):
            begun = time.monotonic()
            while (t := time.monotonic() - begun) < args.duration:
                servo.send(leader(t))
                time.sleep(random.uniform(0.005, 0.035))  # as uneven as a USB bus
            fastest = abs(history.array("qd_target")["qd_target"]).max()
    print(f"{servo.stats.count} targets, {servo.stats.late} late; never faster than {fastest:.2f} rad/s")


if __name__ == "__main__":
    main()

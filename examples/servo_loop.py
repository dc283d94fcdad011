"""Close a loop at the controller's rate: the tool joint follows a moving target, for example from a camera.

python examples/servo_loop.py                       # the simulator
python examples/servo_loop.py 192.168.56.101 --duration 10
"""

import argparse
import math
import sys

import urlink

HOME = (0.0, -1.57, 1.57, -1.57, -1.57, 0.0)
#: Gain of the loop, in 1/s.
EAGERNESS = 5.0


def target(t: float) -> float:
    """Return the wanted position of the tool joint, in rad. Replace this by your camera."""
    return 0.15 * math.sin(math.pi * t)


def main() -> int:
    parser = argparse.ArgumentParser(description="Close a loop.")
    parser.add_argument("address", nargs="?", default="sim://", help="robot or simulator (default: sim://)")
    parser.add_argument("--duration", type=float, default=1.0, help="duration, s (default: 1)")
    args = parser.parse_args()
    try:
        with urlink.connect(args.address) as robot:
            robot.motion.move_joints(HOME, speed=0.5).wait(timeout=120)
            with robot.motion.servo() as servo:
                begun = before = None
                for state in robot.realtime:  # always the newest state, so the loop runs at the controller's rate
                    if begun is None:
                        q, begun, before = state.q_target.copy(), state.time, state.time
                    t = state.time - begun
                    if t > args.duration:
                        break
                    q[5] += EAGERNESS * (target(t) - q[5]) * (state.time - before)
                    before = state.time
                    servo.send(q)
    except urlink.SafetyStop as stop:
        print(f"stopped: {stop.cause}", file=sys.stderr)
        return 1
    except urlink.LinkError as error:
        print(f"{type(error).__name__}: {error}", file=sys.stderr)
        return 1
    stats = servo.stats
    print(f"{stats.count} set-points, every {stats.mean * 1e3:.3f} ms, {stats.late} late")
    print(f"off by less than {stats.p99 * 1e3:.3f} ms in 99 % of the cycles, {stats.max * 1e3:.3f} ms at worst")
    return 0


if __name__ == "__main__":
    sys.exit(main())

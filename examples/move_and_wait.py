"""Move the arm to a posture, up in a straight line, and back, and handle everything that can end a motion.

Before you run it with a real arm: hold the emergency stop, stay out of reach, and read docs/first-day.md.

    python examples/move_and_wait.py                      # the simulator
    python examples/move_and_wait.py 192.168.56.101 --speed 0.1
"""

import argparse
import sys

import numpy as np

import urlink

HOME = (0.0, -1.57, 1.57, -1.57, -1.57, 0.0)


def move(robot: urlink.Robot, speed: float) -> None:
    robot.motion.move_joints(HOME, speed=speed).wait(timeout=120)
    print("at home")

    pose = robot.realtime.wait().tool_vector_actual.copy()
    pose[2] += 0.05
    # Leaving the block before the motion has ended, for example by Ctrl-C, stops the arm.
    with robot.motion.move_linear(pose, speed=0.2 * speed) as motion:
        motion.wait(timeout=120)
    height = robot.realtime.wait().tool_vector_actual[2]
    print(f"5 cm higher, at z = {height:.3f} m")

    motion = robot.motion.move_joints(HOME, speed=speed)
    fastest = 0.0
    for state in robot.realtime:
        fastest = max(fastest, float(np.abs(state.qd_actual).max()))
        if motion.done:
            break
    motion.wait()
    print(f"at home again, never faster than {fastest:.2f} rad/s")


def main() -> int:
    parser = argparse.ArgumentParser(description="Move an arm a little.")
    parser.add_argument("address", nargs="?", default="sim://", help="robot or simulator (default: sim://)")
    parser.add_argument("--speed", type=float, default=0.5, help="speed of the joints, rad/s (default: 0.5)")
    args = parser.parse_args()
    try:
        with urlink.connect(args.address) as robot:
            move(robot, args.speed)
    except urlink.SafetyStop as stop:
        print(f"stopped: {stop.cause}; to continue, see docs/safety.md", file=sys.stderr)
        return 1
    except urlink.LinkError as error:
        print(error, file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())

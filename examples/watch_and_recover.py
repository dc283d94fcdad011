"""Move back and forth; after a stop, wait until a person presses Enter before the arm moves again.

With the policy "always", nothing moves after a stop until `robot.safety.enable()` is called. A person must clear the
stop itself at the robot.

    python examples/watch_and_recover.py 192.168.56.101
    python examples/watch_and_recover.py --demonstrate   # the simulator makes a protective stop, without a question
"""

import argparse
import sys
import threading
from collections.abc import Callable

import urlink
from urlink.simulator import Controller

LEFT = (-0.1, -1.57, 1.57, -1.57, -1.57, 0.0)
RIGHT = (0.1, -1.57, 1.57, -1.57, -1.57, 0.0)


def go(robot: urlink.Robot, q: tuple[float, ...], ask: Callable[[], object]) -> None:
    """Move to `q`, and try again after each stop."""
    while True:
        try:
            robot.motion.move_joints(q, speed=0.5).wait(timeout=60)
            return
        except (urlink.SafetyStop, urlink.NotRunning) as error:
            print(f"not moving: {error}", flush=True)
            recover(robot, ask)


def recover(robot: urlink.Robot, ask: Callable[[], object]) -> None:
    print("find the cause, and clear the stop at the pendant", flush=True)
    robot.safety.wait_until_clear(timeout=3600)
    ask()
    robot.safety.enable()
    # The stopped program might still be paused on the controller. This motion replaces it.
    robot.motion.stop().wait(timeout=10)
    print("continuing", flush=True)


def main() -> int:
    parser = argparse.ArgumentParser(description="Recover from stops.")
    parser.add_argument("address", nargs="?", default="sim://", help="robot or simulator (default: sim://)")
    parser.add_argument("--rounds", type=int, default=2, help="number of rounds (default: 2)")
    parser.add_argument("--demonstrate", action="store_true", help="make a protective stop in the simulator")
    args = parser.parse_args()

    try:
        with urlink.connect(args.address, require_enable="always") as robot:
            robot.safety.enable()
            robot.motion.move_joints(LEFT, speed=0.5).wait(timeout=60)
            if args.demonstrate and robot.controller is not None:
                threading.Timer(0.2, misfortune, (robot.controller,)).start()
            ask = (lambda: None) if args.demonstrate else (lambda: input("press Enter when the arm may move"))
            for _ in range(args.rounds):
                go(robot, RIGHT, ask)
                go(robot, LEFT, ask)
    except urlink.LinkError as error:
        print(f"{type(error).__name__}: {error}", file=sys.stderr)
        return 1
    print("done")
    return 0


def misfortune(controller: Controller) -> None:
    controller.faults.protective_stop()
    threading.Timer(0.3, controller.faults.clear).start()


if __name__ == "__main__":
    sys.exit(main())

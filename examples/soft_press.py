"""Move the arm softly over a table, with ten targets per second: its virtual springs limit the force on the table.

python examples/soft_press.py                       # the simulator, with a table
python examples/soft_press.py 192.168.56.101        # a robot with firmware 5.23 or later, 5 mm above a table
"""

import argparse
import sys
import time

import urlink


def work(robot):
    arm = robot.identity.kinematics
    state = robot.realtime.wait()
    q, pose = state.q_actual, state.tool_vector_actual.copy()
    pose[2] -= 0.015
    with robot.motion.impedance(damping=1.0, speed=0.5) as soft:
        for _ in range(30):
            pose[1] += 0.002
            q = arm.inverse(pose, q)
            soft.send(q)
            time.sleep(0.1)
        pressed = robot.realtime.wait().tcp_force[2]
        print("presses softly" if 2.0 < pressed < 100.0 else f"presses with {pressed:.0f} N")
    print("released")


def main() -> int:
    parser = argparse.ArgumentParser(description="Slide softly.")
    parser.add_argument("address", nargs="?", help="robot (default: a simulated robot with a table)")
    args = parser.parse_args()
    try:
        if args.address is not None:
            with urlink.connect(args.address) as robot:
                work(robot)
            return 0
        from urlink.simulator import Controller, Plane, Still

        with Controller("UR5e", "5.25", motion=Still()) as controller:
            x, y, z = controller.arm.kinematics.forward(controller.arm.setpoint.q)[:3]
            controller.world.add(Plane((x, y, z - 0.005)))
            with urlink.connect(controller.address) as robot:
                work(robot)
    except urlink.LinkError as error:
        print(f"{type(error).__name__}: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())

"""Find the table, press on it, teach two waypoints above it by hand, and play them.

python examples/press_and_teach.py                       # the simulator, with a table and a hand
python examples/press_and_teach.py 192.168.56.101        # a robot with its payload set, 10 cm above a table
"""

import argparse
import sys

import urlink

DOWN = (0.0, 0.0, -1.0)


def hand(controller, newtons):
    """Push a simulated arm upwards. Push a real arm yourself."""
    if controller is not None:
        controller.push([0.0, 0.0, newtons, 0.0, 0.0, 0.0])


def work(robot, controller):
    robot.zero_force_sensor()
    contact = robot.motion.until_contact(DOWN, speed=0.03, wait=True).contact
    print(f"the table is at z = {contact.pose[2]:.3f} m")

    with robot.motion.force_mode("base", [0, 0, 1, 0, 0, 0], [0, 0, -10, 0, 0, 0], [0.05] * 6):
        state = robot.realtime.wait_until(lambda state: abs(state.tcp_force[2] - 10.0) < 0.5, timeout=30)
        print(f"pressed with {round(state.tcp_force[2])} N")

    with robot.teach(on_point=lambda point: print("recorded a waypoint")) as teaching:
        for height in (0.02, 0.04):
            hand(controller, 15.0)
            above = contact.pose[2] + height
            robot.realtime.wait_until(lambda state, above=above: state.tool_vector_actual[2] > above, timeout=60)
            hand(controller, 0.0)
            teaching.record()
    teaching.taught.play(robot, speed=0.5, wait=True)
    print("played")


def main() -> int:
    parser = argparse.ArgumentParser(description="Press and teach.")
    parser.add_argument("address", nargs="?", help="robot (default: a simulated robot with a table)")
    args = parser.parse_args()
    try:
        if args.address is not None:
            with urlink.connect(args.address) as robot:
                work(robot, None)
            return 0
        from urlink.simulator import Controller, Plane, Still

        with Controller("UR5e", "5.11", motion=Still()) as controller:
            x, y, z = controller.arm.kinematics.forward(controller.arm.setpoint.q)[:3]
            controller.world.add(Plane((x, y, z - 0.02)))
            with urlink.connect(controller.address) as robot:
                work(robot, controller)
    except urlink.LinkError as error:
        print(f"{type(error).__name__}: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())

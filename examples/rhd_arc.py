"""Drive an arc of a given radius and angle, and stop at its end.

In the set-up for which the bridge was made, the robot kept driving in the same circle forever: the end of MRC's `turnr`
ends a step of the script, but not the motion. Here, the program that measures the angle also stops the robot.

    python examples/rhd_arc.py arc.svg --radius 2 --angle 135
"""

from __future__ import annotations

import argparse
import math

import rhdlink
from rhdlink.host.plugins.turtle import Turtle
from rhdlink.host.world import World, save

PERIOD = 0.01
SPEED = 0.3


def arc(robot: rhdlink.robots.VelocityOmega, radius: float, angle: float) -> None:
    """Drive along a circle until the heading has changed by `angle` rad, to the left if positive."""
    end = robot.rotpos + angle
    under_way = 0.0
    while True:
        # The last command affects the heading only in the next reply.
        left = end - robot.rotpos - under_way
        rate = math.copysign(min(SPEED / radius, abs(left) / PERIOD), left)
        if abs(rate) < 1 / 40000:
            break
        robot.cmdtransvel = abs(rate) * radius
        robot.cmdrotvel = rate
        under_way = rate * PERIOD
        robot.sync()
    robot.cmdtransvel = robot.cmdrotvel = 0.0
    robot.sync()
    robot.sync()


def main() -> None:
    parser = argparse.ArgumentParser(description="Drive an arc.")
    parser.add_argument(
        "picture", nargs="?", default="arc.svg", help="file for the figure, .svg or .png (default: arc.svg)"
    )
    parser.add_argument("--radius", type=float, default=2.0, help="radius, m (default: 2)")
    parser.add_argument("--angle", type=float, default=135.0, help="angle to the left, degrees (default: 135)")
    args = parser.parse_args()
    angle = math.radians(args.angle)

    world = World()
    with (
        rhdlink.Host([Turtle(world)], period=PERIOD, port=0, pacing="lockstep") as host,
        rhdlink.connect(f"127.0.0.1:{host.port}", rhdlink.robots.VelocityOmega, access="w") as robot,
    ):
        arc(robot, args.radius, angle)
    at = world.odometry
    side = math.copysign(args.radius, angle)
    should = side * math.sin(angle), side * (1.0 - math.cos(angle))
    print(f"ended at x {at.x:.3f} m, y {at.y:.3f} m, heading {math.degrees(at.theta):.2f} deg")
    print(f"should be x {should[0]:.3f} m, y {should[1]:.3f} m, heading {args.angle:.2f} deg")
    save(world, args.picture, f"An arc of {args.radius:g} m and {args.angle:g} degrees")


if __name__ == "__main__":
    main()

"""Drive a square spiral with a closing diagonal: program, host, bridge and robot, with poses in the other direction.

The robot is a turtle that has velocities and poses but does not implement RHD, like a robot with any other software.
The bridge connects it to RHD. Everything runs in lockstep, so the run is fast and is the same each time.

    python examples/rhd_spiral.py spiral.svg
"""

from __future__ import annotations

import math
import sys

import rhdlink
from rhdlink.host.plugins.velocity import Twist, VelocityBridge
from rhdlink.host.world import World, save

PERIOD = 0.01


class BridgedTurtle(VelocityBridge):
    """Bridge that moves a turtle, and reports its pose."""

    def __init__(self, world: World) -> None:
        super().__init__(self.drive, own_thread=False)
        self.world = world
        self.twist = Twist(0.0, 0.0)

    def drive(self, twist: Twist) -> None:
        self.twist = twist

    def init(self, config: rhdlink.host.Element) -> None:
        super().init(config)
        self.update_pose(*self.world.pose)

    def periodic(self, tick: int) -> None:
        super().periodic(tick)
        self.world.step(self.twist.linear, self.twist.angular, PERIOD)
        self.update_pose(*self.world.pose)


class Driver:
    """Program that drives a velocity-omega robot by its odometry."""

    def __init__(self, robot: rhdlink.robots.VelocityOmega) -> None:
        self.robot = robot
        self.heading = 0.0

    def forward(self, metres: float, speed: float = 0.5) -> None:
        """Drive straight ahead along the wanted heading, and more slowly towards the end."""
        robot = self.robot
        end = robot.transpos + metres * 1e5
        while (left := (end - robot.transpos) / 1e5) > 0.002:
            robot.cmdtransvel = min(speed, math.sqrt(0.6 * left))
            robot.cmdrotvel = 2.0 * (self.heading - robot.rotpos)
            robot.sync()

    def turn(self, degrees: float, rate: float = 1.5) -> None:
        """Turn on the spot, to the left."""
        robot = self.robot
        self.heading += math.radians(degrees)
        robot.cmdtransvel = 0.0
        while abs(left := self.heading - robot.rotpos) > 0.002:
            robot.cmdrotvel = math.copysign(min(rate, 3.0 * abs(left)), left)
            robot.sync()

    def stop(self) -> None:
        self.robot.cmdtransvel = self.robot.cmdrotvel = 0.0
        self.robot.sync()
        self.robot.sync()


def spiral(driver: Driver) -> None:
    for leg in range(8):
        driver.forward(0.6 + 0.6 * leg)
        driver.turn(90)
    driver.turn(45)
    # The eight legs end 2.4 m to the left of the start and 2.4 m below it, so the diagonal closes the path.
    driver.forward(math.hypot(2.4, 2.4))
    driver.stop()


def main(path: str) -> None:
    world = World(start=(5.5, 5.0, 0.0))
    with (
        rhdlink.Host([BridgedTurtle(world)], period=PERIOD, port=0, pacing="lockstep") as host,
        rhdlink.connect(f"127.0.0.1:{host.port}", rhdlink.robots.VelocityOmega, access="w") as robot,
    ):
        spiral(Driver(robot))
        print(f"{host.tick * PERIOD:.1f} s of driving, ended {math.hypot(*world.odometry[:2]):.2f} m from the start")
    save(world, path, "A square spiral with a closing diagonal")


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else "spiral.svg")

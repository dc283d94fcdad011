"""Follow a line with a robot that uses MQTT, then stop before a wall: a mission, on a robot or on a simulated one.

The mission is `missions/line.smr`. Without an address, the program simulates a robot, which needs a broker on this
computer, such as mosquitto.

    pip install 'urlink-robot[mqtt]'
    python examples/robobot_line.py
    python examples/robobot_line.py mqtt://192.168.0.55
"""

from __future__ import annotations

import argparse
import math
from pathlib import Path

import rhdlink
from rhdlink.host.scene import Scene, Tape
from rhdlink.host.world import World
from rhdlink.mqtt import SimulatedRobobot

MISSION = Path(__file__).parent / "missions" / "line.smr"


def new_world() -> World:
    """A white tape with a bend on a black floor, and a wall behind its end."""
    bend = [(1.0 + 0.05 * n, 5.5 + 0.2 * math.sin(0.1 * n)) for n in range(63)]
    scene = Scene([Tape(tuple(bend), brightness=1.0)], [[(5.5, 3.0), (5.5, 8.0)]], floor=0.0)
    return World(11.0, (0.9, 5.5, 0.2), scene)


def follow(address: str) -> None:
    mission = rhdlink.Mission(MISSION, address)
    mission.on("line", print)
    mission.on("values", lambda text: print(f"x, y and distance to the wall in m: {text}"))
    mission.run(timeout=120.0)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("address", nargs="?", help="such as mqtt://192.168.0.55 (default: a simulated robot)")
    parser.add_argument("--port", type=int, default=1883, help="port of the broker for the simulated robot")
    args = parser.parse_args()
    if args.address is not None:
        follow(args.address)
        return
    with SimulatedRobobot(port=args.port, world=new_world()) as robot:
        follow(robot.address)
        x, y, heading = robot.world.pose
        print(f"the simulated robot is at x {x:.2f} m, y {y:.2f} m, heading {math.degrees(heading):.0f} deg")


if __name__ == "__main__":
    main()

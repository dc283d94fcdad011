"""Follow a line, drive round a wall and dock at a pose: one mission, started in three ways, with a simulated robot.

The mission is started from Python, from the command line, and through the port on which MRC accepts commands. It is
`missions/dock.smr`, on the floor in `missions/floor.svg`. The robot does not wait for real time, and behaves the same
each time, so all three runs end at the same place.

    python examples/rhd_mission.py way.svg
"""

from __future__ import annotations

import math
import socket
import subprocess
import sys
from pathlib import Path

import rhdlink
from rhdlink.host.plugins.turtle import SmrTurtle
from rhdlink.host.scene import Scene
from rhdlink.host.world import Pose, World, save
from rhdlink.smrcl.robot_link import PluginLink

MISSIONS = Path(__file__).parent / "missions"
SCRIPT, FLOOR = MISSIONS / "dock.smr", MISSIONS / "floor.svg"
START = 1.5, 2.0, 0.0


def new_world() -> World:
    return World(11.0, START, Scene.from_svg(FLOOR, 11.0))


def told(pose: Pose) -> str:
    return f"ended at x {pose.x:.3f} m, y {pose.y:.3f} m, heading {math.degrees(pose.theta):.1f} deg"


def from_python(picture: str) -> str:
    world = new_world()
    mission = rhdlink.Mission(SCRIPT, SmrTurtle(world))
    mission.on("event", lambda text: print(f"{'':14}{text}"))
    with mission.start() as run:
        run.wait(60.0)
    save(world, picture, "Along a line, round a wall, and to a pose")
    return told(world.pose)


def from_the_command_line() -> str:
    words = [sys.executable, "-m", "rhdlink.cli", "mission", str(SCRIPT), "--turtle", "smr"]
    words += ["--floor", str(FLOOR), "--start", ",".join(map(str, START))]
    done = subprocess.run(words, capture_output=True, text=True, timeout=60, check=True)
    return done.stderr.splitlines()[-1].removeprefix("rhdlink: ")


def through_the_port() -> str:
    world = new_world()
    robot = PluginLink([SmrTurtle(world)])
    with rhdlink.smrcl.MissionServer(robot, port=0) as server:
        with (
            socket.create_connection(("127.0.0.1", server.port), timeout=60.0) as connection,
            connection.makefile("r", encoding="latin-1") as answers,
        ):

            def ask(line: str) -> str:
                connection.sendall(f"{line}\n".encode("latin-1"))
                return answers.readline().strip()

            ask("beginplan dock")
            for line in SCRIPT.read_text().splitlines():
                ask(f"plan {line}")
            ask("endplan")
            ask("runplan dock")
            while ask("getevent 600") != "userevent docked":
                pass
        pose = world.pose
    robot.close()
    return told(pose)


def main() -> None:
    picture = sys.argv[1] if len(sys.argv) > 1 else "way.svg"
    print(f"Python        {from_python(picture)}")
    print(f"command line  {from_the_command_line()}")
    print(f"port          {through_the_port()}")


if __name__ == "__main__":
    main()

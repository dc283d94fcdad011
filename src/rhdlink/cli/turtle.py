"""`rhdlink turtle`: host a simulated robot."""

from __future__ import annotations

import argparse
import math

from linkcore.cli.options import DURATION, argument, command, seconds
from linkcore.cli.terminal import Interruption

from ..address import PORT, parse_mqtt_address
from ..host.host import Host, Pacing
from ..host.plugins.turtle import SmrTurtle, Turtle
from ..host.world import World
from ..mqtt.commands import DIALECTS
from ..mqtt.simulated import SimulatedRobobot
from ..wire.decoder import Limits
from .hosting import run_until_told, serve_until_told, service_arguments, service_options
from .options import port, tell
from .turtle_world import WORLD, drawn, world


@command(
    "turtle",
    "run a simulated robot in a square world",
    argument(
        "--drive", choices=("velocity", "smr", "mqtt"), default="velocity", help="kind of robot (default: velocity)"
    ),
    argument(
        "--broker", default="mqtt://localhost", metavar="URL", help="broker of --drive mqtt (default: mqtt://localhost)"
    ),
    argument("--dialect", choices=tuple(DIALECTS), default="2026", help="commands of --drive mqtt (default: 2026)"),
    argument(
        "--port", type=port, default=PORT, metavar="P", help=f"listen on port P, 0 for a free port (default: {PORT})"
    ),
    argument("--period", type=seconds, default=0.01, metavar="S", help="seconds between ticks (default: 0.01)"),
    argument("--lockstep", action="store_true", help="make one tick for each request of the master"),
    *service_options(""),
    *WORLD,
    argument("--picture", metavar="FILE", help="draw the path into FILE at the end: .svg or .png"),
    DURATION,
)
def run(args: argparse.Namespace) -> int:
    """Run a simulated robot in a walled square of 11 x 11 m, until Ctrl-C, SIGTERM or --duration. Programs connect to
    it in the same way as to a real robot.

      --drive velocity   speed and turn rate: cmdtransvel, cmdrotvel; transpos, rotpos
      --drive smr        two wheels: speedl, speedr; encl, encr, irsensor, linesensor
      --drive mqtt       a robot of DTU with MQTT, on a running broker such as mosquitto

    The robot stops when its master leaves, and at walls. With --lockstep, simulated time advances only with requests
    of the master: each run is the same, and as fast as the program sends requests. With --picture, the path is drawn
    at the end.

    examples:
      rhdlink turtle
      rhdlink turtle --drive smr --picture way.svg --duration 60
      rhdlink turtle --port 0 --lockstep
      rhdlink turtle --drive mqtt --dialect 2025 --floor floor.svg
    """
    floor = world(args)
    if args.picture is not None:
        drawn(floor, args, args.picture)  # raises an error immediately if it cannot be written
    status = _run_with_mqtt(args, floor) if args.drive == "mqtt" else _run_with_rhd(args, floor)
    pose = floor.pose
    tell(f"ended at x {pose.x:.3f} m, y {pose.y:.3f} m, heading {math.degrees(pose.theta):.1f} deg")
    if args.picture is not None:
        drawn(floor, args, args.picture)
    return status


def _run_with_rhd(args: argparse.Namespace, floor: World) -> int:
    robot = Turtle(floor) if args.drive == "velocity" else SmrTurtle(floor)
    pacing: Pacing = "lockstep" if args.lockstep else "period"
    host = Host([robot], period=args.period, pacing=pacing, **service_arguments(args, Limits()))
    return serve_until_told(host, f"turtle, driven by {args.drive}", args.duration)


def _run_with_mqtt(args: argparse.Namespace, floor: World) -> int:
    broker = parse_mqtt_address(args.broker)
    robot = SimulatedRobobot(broker.host, broker.port, dialect=broker.dialect or args.dialect, world=floor)
    with Interruption() as interruption:
        run_until_told(robot, f"simulated robot with MQTT, commands of {robot.dialect}", args.duration, interruption)
    return interruption.status

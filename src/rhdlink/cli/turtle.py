"""`rhdlink turtle`: host a simulated robot."""

from __future__ import annotations

import argparse
import math

from linkcore.cli.options import DURATION, argument, command, seconds

from ..address import PORT
from ..host.host import Host, Pacing
from ..host.plugins.turtle import SmrTurtle, Turtle
from ..wire.decoder import Limits
from .hosting import serve_until_told, service_arguments, service_options
from .options import port, tell
from .turtle_world import WORLD, drawn, world


@command(
    "turtle",
    "run a simulated robot in a square world",
    argument("--drive", choices=("velocity", "smr"), default="velocity", help="kind of robot (default: velocity)"),
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

    The robot stops when its master leaves, and at walls. With --lockstep, simulated time advances only with requests
    of the master: each run is the same, and as fast as the program sends requests. With --picture, the path is drawn
    at the end.

    examples:
      rhdlink turtle
      rhdlink turtle --drive smr --picture way.svg --duration 60
      rhdlink turtle --port 0 --lockstep
    """
    robot = Turtle(world(args)) if args.drive == "velocity" else SmrTurtle(world(args))
    if args.picture is not None:
        drawn(robot.world, args, args.picture)  # raises an error immediately if it cannot be written
    pacing: Pacing = "lockstep" if args.lockstep else "period"
    host = Host([robot], period=args.period, pacing=pacing, **service_arguments(args, Limits()))
    status = serve_until_told(host, f"turtle, driven by {args.drive}", args.duration)
    pose = robot.world.pose
    tell(f"ended at x {pose.x:.3f} m, y {pose.y:.3f} m, heading {math.degrees(pose.theta):.1f} deg")
    if args.picture is not None:
        drawn(robot.world, args, args.picture)
    return status

"""`rhdlink turtle`: a robot without hardware."""

from __future__ import annotations

import argparse
import math

from linkcore.cli.options import Subparsers, add_command, seconds

from ..address import PORT
from ..drawing import save
from ..host import Host
from ..plugins.turtle import SmrTurtle, Turtle
from .options import port, tell
from .serving import serve_until_told

__all__ = ["add_parser"]

_DESCRIPTION = """\
Run a robot in a walled square of 11 x 11 m, until Ctrl-C, SIGTERM or --duration; programs connect to it as
to a real one.

  --drive velocity   speed and turn rate: cmdtransvel, cmdrotvel; transpos, rotpos
  --drive smr        two wheels: speedl, speedr; encl, encr, irsensor, linesensor

It stops when its master leaves, and at walls. With --lockstep the time of the world goes on with each request
of the master and not otherwise: the same each time, and as fast as the program asks. With --picture the way
it went is drawn at the end."""

_EXAMPLES = (
    "rhdlink turtle",
    "rhdlink turtle --drive smr --picture way.svg --duration 60",
    "rhdlink turtle --port 0 --lockstep",
)


def add_parser(subparsers: Subparsers) -> None:
    """Declare the command."""
    parser = add_command(subparsers, "turtle", "run a robot in a square world", _DESCRIPTION, _EXAMPLES)
    parser.add_argument("--drive", choices=("velocity", "smr"), default="velocity", help="kind of robot (velocity)")
    parser.add_argument(
        "--port", type=port, default=PORT, metavar="P", help=f"listen on port P, 0 for a free one ({PORT})"
    )
    parser.add_argument("--period", type=seconds, default=0.01, metavar="S", help="seconds between ticks (0.01)")
    parser.add_argument("--lockstep", action="store_true", help="one tick with each request of the master")
    parser.add_argument("--picture", metavar="FILE", help="draw the way into FILE at the end: .svg or .png")
    parser.add_argument("--duration", type=seconds, metavar="S", help="end after S seconds (never)")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Serve until told to stop.

    Raises:
        BadAddress: the port is taken.
        BadValue: the picture cannot be written.
    """
    robot = Turtle() if args.drive == "velocity" else SmrTurtle()
    if args.picture is not None:
        save(robot.world, args.picture)  # says at once whether it can be written
    host = Host([robot], period=args.period, port=args.port, pacing="lockstep" if args.lockstep else "period")
    ended = serve_until_told(host, "127.0.0.1", f"turtle, driven by {args.drive}", args.duration)
    pose = robot.world.pose
    tell(f"ended at x {pose.x:.3f} m, y {pose.y:.3f} m, heading {math.degrees(pose.theta):.1f} deg")
    if args.picture is not None:
        save(robot.world, args.picture)
    ended.raise_if_any()
    return 0

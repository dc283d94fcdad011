"""`rhdlink serve` and `turtle`: host a robot, from an `rhdconfig.xml` or without hardware."""

from __future__ import annotations

import argparse
import math
import sys
from dataclasses import fields, replace
from pathlib import Path
from typing import Any, get_args

from linkcore.cli.options import DURATION, Row, argument, command, seconds
from linkcore.cli.terminal import Interruption

from ..address import PORT
from ..host.config import read_config
from ..host.host import Host, Pacing
from ..host.plugins.turtle import SmrTurtle, Turtle
from ..host.service import Resend
from ..wire.decoder import Limits
from ..wire.schema import WIDTHS
from .options import WORLD, drawn, port, tell, world


def _service(args: argparse.Namespace, limits: Limits) -> dict[str, Any]:
    """The arguments of `Host` that were given, and the limits: those that were not given are those of `limits`."""
    # `turtle` has no option for the address.
    names = ("port", "address", "width", "resend", "client_timeout", "inactivity_timeout")
    given = {name: value for name in names if (value := getattr(args, name, None)) is not None}
    return {**given, "limits": replace(limits, **dict(args.limit))}


_LIMITS = tuple(field.name for field in fields(Limits))


def _limit(text: str) -> tuple[str, int]:
    """One limit, as it is given on the command line."""
    name, _, number = text.partition("=")
    if name not in _LIMITS or not number.isdecimal() or int(number) < 1:
        raise argparse.ArgumentTypeError(f"{text!r}; expected NAME=N, NAME being one of {', '.join(_LIMITS)}")
    return name, int(number)


def _service_rows(default: str) -> tuple[Row, ...]:
    return (
        argument(
            "--width",
            type=int,
            choices=WIDTHS,
            help="32-bit words of a time stamp, as the clients have it: 4 if they are 64-bit builds of the original's "
            f"ordinary sources, which would decode garbage ({default}2)",
        ),
        argument(
            "--resend",
            choices=get_args(Resend),
            help=f"variables in a reply: those set since the last one, or all that were ever set ({default}changed)",
        ),
        argument(
            "--client-timeout",
            type=seconds,
            metavar="S",
            help=f"seconds for a request to be complete, or a reply to be read ({default}5)",
        ),
        argument(
            "--inactivity-timeout",
            type=seconds,
            metavar="S",
            help=f"seconds without a request after which a reader may lose its slot ({default}10)",
        ),
        argument(
            "--limit",
            action="append",
            default=[],
            type=_limit,
            metavar="NAME=N",
            help=f"the most that a client may request: {', '.join(_LIMITS)} (in bytes); can be repeated",
        ),
    )


@command(
    "serve",
    "run plugins and serve their variables",
    argument("config", metavar="CONFIG.xml", help="an rhdconfig.xml"),
    argument("--port", type=port, metavar="P", help="listen on port P, 0 for a free one (the file's)"),
    argument("--listen", dest="address", metavar="H", help="listen on the address H (the file's, or 127.0.0.1)"),
    *_service_rows("the file's, or "),
    DURATION,
)
def _serve(args: argparse.Namespace) -> int:
    """Host a robot: run the plugins that an rhdconfig.xml names, and serve their variables, until Ctrl-C, SIGTERM or
    --duration. Plugins are closed at the end.

    The file is that of the original daemon, with plugins in Python: lib="package.module:Class". Modules are
    searched in Python's path, then in the folder of the file. Without <address value="..."/> in <server> only
    programs on this machine can connect: whoever can connect can drive the robot. When a plugin with
    critical="true" fails, the robot is shut down with exit status 1; other plugins that fail are disabled.

    examples:
      rhdlink serve rhdconfig.xml
      rhdlink serve rhdconfig.xml --port 0 --duration 10
      rhdlink serve rhdconfig.xml --listen 0.0.0.0 -v
    """
    config = read_config(args.config)
    folder = str(Path(args.config).resolve().parent)
    # Last, so that no file there shadows a module that is imported elsewhere.
    sys.path.append(folder)
    try:
        host = Host.from_config(config, **_service(args, config.limits))
        names = ", ".join(plugin.name for plugin in host.plugins) or "no plugin"
        return _serve_until_told(host, f"{args.config}: {names}", args.duration)
    finally:
        sys.path.remove(folder)


@command(
    "turtle",
    "run a simulated robot in a square world",
    argument("--drive", choices=("velocity", "smr"), default="velocity", help="kind of robot (velocity)"),
    argument("--port", type=port, default=PORT, metavar="P", help=f"listen on port P, 0 for a free one ({PORT})"),
    argument("--period", type=seconds, default=0.01, metavar="S", help="seconds between ticks (0.01)"),
    argument("--lockstep", action="store_true", help="one tick with each request of the master"),
    *_service_rows(""),
    *WORLD,
    argument("--picture", metavar="FILE", help="draw the path into FILE at the end: .svg or .png"),
    DURATION,
)
def _turtle(args: argparse.Namespace) -> int:
    """Run a simulated robot in a walled square of 11 x 11 m, until Ctrl-C, SIGTERM or --duration; programs connect to
    it as to a real one.

      --drive velocity   speed and turn rate: cmdtransvel, cmdrotvel; transpos, rotpos
      --drive smr        two wheels: speedl, speedr; encl, encr, irsensor, linesensor

    It stops when its master leaves, and at walls. With --lockstep simulated time advances with each request of the
    master and not otherwise: the same each time, and as fast as the program requests. With --picture the path is
    drawn at the end.

    examples:
      rhdlink turtle
      rhdlink turtle --drive smr --picture way.svg --duration 60
      rhdlink turtle --port 0 --lockstep
    """
    robot = Turtle(world(args)) if args.drive == "velocity" else SmrTurtle(world(args))
    if args.picture is not None:
        drawn(robot.world, args, args.picture)  # raises at once if it cannot be written
    pacing: Pacing = "lockstep" if args.lockstep else "period"
    host = Host([robot], period=args.period, pacing=pacing, **_service(args, Limits()))
    status = _serve_until_told(host, f"turtle, driven by {args.drive}", args.duration)
    pose = robot.world.pose
    tell(f"ended at x {pose.x:.3f} m, y {pose.y:.3f} m, heading {math.degrees(pose.theta):.1f} deg")
    if args.picture is not None:
        drawn(robot.world, args, args.picture)
    return status


def _serve_until_told(host: Host, what: str, duration: float | None) -> int:
    """Serve until Ctrl-C, SIGTERM or the end of `duration`; then stop properly, print statistics, return the status.

    The address is printed on stdout once clients can connect.

    Raises:
        PluginFailed: a critical plugin raised.
        BadAddress: the port cannot be listened on.
    """
    with Interruption() as interruption:
        with host:
            tell(f"{what}; Ctrl-C ends it; connect to")
            print(host.address, flush=True)
            interruption.end_after(duration)
            while not host.wait(0.0) and not interruption.wait(0.1):
                pass
        stats = host.stats
        tell(
            f"{stats.ticks} ticks, late by {1e3 * stats.late_median:.3f} ms (median), {1e3 * stats.late_p99:.3f} ms "
            f"(99 of 100 less), {stats.overruns} overruns; {stats.refused_writes} writes refused, "
            f"{stats.bad_clients} clients closed for what they sent"
        )
        if stats.failed_plugins:
            tell(f"failed plugins: {', '.join(stats.failed_plugins)}")
    return interruption.status

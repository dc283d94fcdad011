"""The common part of several commands: the address of a robot, and a status line."""

from __future__ import annotations

import argparse
import math
import sys
from typing import Any

from linkcore.cli.options import argument, seconds
from linkcore.cli.progress import ProgressBar
from linkcore.text import printable

from ..client import Variables, connect
from ..host.scene import Scene
from ..host.world import World, save

#: The address of a robot, and how long to wait for it.
ADDRESS = (
    argument("address", metavar="ADDRESS", help="a host, or host:port; the port is 24902 unless named"),
    argument(
        "--timeout", type=seconds, default=5.0, metavar="S", help="give up when the robot is silent for S seconds (5)"
    ),
)

#: The size of a turtle's world, m.
_SIZE = 11.0


def world(args: argparse.Namespace) -> World:
    """The world of the options.

    Raises:
        BadValue: the drawing cannot be read, or the start is outside.
    """
    scene = None if args.floor is None else Scene.from_svg(args.floor, _SIZE)
    return World(_SIZE, args.start, scene)


def pose(text: str) -> tuple[float, float, float]:
    """``X,Y,DEG``: m, m, and the heading in rad."""
    try:
        x, y, degrees = (float(word) for word in text.split(","))
    except ValueError:
        x = y = degrees = math.nan
    if not all(map(math.isfinite, (x, y, degrees))):
        raise argparse.ArgumentTypeError(f"{text!r} is no pose; expected X,Y,DEG")
    return x, y, math.radians(degrees)


#: The options of a turtle's world: tape, walls, and the turtle's pose.
WORLD = (
    argument(
        "--floor", metavar="FILE.svg", help="tape and walls of the turtle's world: lines of the drawing, walls by class"
    ),
    argument("--start", type=pose, metavar="X,Y,DEG", help="where the turtle begins, m and degrees (the middle, 0)"),
)


def port(text: str) -> int:
    """A TCP port, or 0 for a free one."""
    if not (text.isascii() and text.isdecimal()) or int(text) > 65535:
        raise argparse.ArgumentTypeError(f"{text!r} is not a port from 0 to 65535")
    return int(text)


def connected(args: argparse.Namespace, address: str | None = None, **how: Any) -> Variables:
    """Connect to a robot, and show the progress.

    Args:
        args: The arguments of a command that takes `ADDRESS`.
        address: Address of the robot; None for the one in `args`.
        how: Further arguments of `connect`.

    Raises:
        LinkError: See `connect`.
    """
    address = args.address if address is None else address
    with ProgressBar(f"connecting to {address}", args.quiet):
        robot: Variables = connect(address, timeout=args.timeout, **how)
        return robot


def drawn(world: World, args: argparse.Namespace, path: str, title: str = "") -> None:
    """Draw the path of a turtle into a file, and show the progress.

    Raises:
        LinkError: See `rhdlink.host.world.save`.
    """
    with ProgressBar(f"drawing {path}", args.quiet):
        save(world, path, title)


def tell(text: str) -> None:
    """One line on stderr."""
    print(f"rhdlink: {printable(text)}", file=sys.stderr)

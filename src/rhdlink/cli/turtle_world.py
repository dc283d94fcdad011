"""World of a turtle, for the commands `turtle` and `mission`: options, and a drawing of the path."""

from __future__ import annotations

import argparse
import math

from linkcore.cli.options import argument
from linkcore.cli.progress import ProgressBar

from ..host.scene import Scene
from ..host.world import World, save

#: Side length of a turtle's world, in m.
_SIZE = 11.0


def world(args: argparse.Namespace) -> World:
    """Create the world from the options.

    Raises:
        BadValue: If the drawing cannot be read, or the start is outside the world.
    """
    scene = None if args.floor is None else Scene.from_svg(args.floor, _SIZE)
    return World(_SIZE, args.start, scene)


def pose(text: str) -> tuple[float, float, float]:
    """Parse ``X,Y,DEG`` to m, m, and the heading in rad."""
    try:
        x, y, degrees = (float(word) for word in text.split(","))
    except ValueError:
        x = y = degrees = math.nan
    if not all(map(math.isfinite, (x, y, degrees))):
        raise argparse.ArgumentTypeError(f"{text!r} is not a pose; expected X,Y,DEG")
    return x, y, math.radians(degrees)


#: Options for the world of a turtle: tape, walls, and the pose of the turtle.
WORLD = (
    argument(
        "--floor",
        metavar="FILE.svg",
        help="tape and walls of the turtle's world: the lines of a drawing; a class marks walls",
    ),
    argument(
        "--start", type=pose, metavar="X,Y,DEG", help="start pose of the turtle, m and degrees (default: the middle, 0)"
    ),
)


def drawn(world: World, args: argparse.Namespace, path: str, title: str = "") -> None:
    """Draw the path of a turtle into a file, and show the progress.

    Raises:
        LinkError: See `rhdlink.host.world.save`.
    """
    with ProgressBar(f"drawing {path}", args.quiet):
        save(world, path, title)

"""The world of a turtle for `turtle` and `mission`: its options, and the drawing of the path in it."""

from __future__ import annotations

import argparse
import math

from linkcore.cli.options import argument
from linkcore.cli.progress import ProgressBar

from ..host.scene import Scene
from ..host.world import World, save

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


def drawn(world: World, args: argparse.Namespace, path: str, title: str = "") -> None:
    """Draw the path of a turtle into a file, and show the progress.

    Raises:
        LinkError: See `rhdlink.host.world.save`.
    """
    with ProgressBar(f"drawing {path}", args.quiet):
        save(world, path, title)

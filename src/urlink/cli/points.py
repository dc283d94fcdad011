"""`urlink points`: lists, shows, checks, removes and imports the points in a file."""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable
from typing import Any

from linkcore.cli.options import argument, command
from linkcore.errors import BadValue
from linkcore.text import printable, strict_json

from ..arm.models import MODELS, model
from ..motion.points.point import Point, PointCheck
from ..motion.points.point_file import PointFile, described
from ..motion.points.program_file import read_waypoints
from .options import CONNECT_TIMEOUT, connected


@command(
    "points",
    "list, show, check, remove and import points",
    argument("action", choices=("list", "show", "check", "remove", "import"), help="what to do with the file"),
    argument("file", metavar="FILE", help="JSON file of the points"),
    argument(
        "words",
        metavar="WORD",
        nargs="*",
        trailing=True,
        help="names to show or remove; the address of a robot and names to check; or a program (.urp) to import",
    ),
    argument("--model", metavar="ARM", words=lambda: MODELS, help="arm of the imported program, such as UR5e"),
    argument("--replace", action="store_true", help="let imported points replace points that have the same names"),
    argument("--json", action="store_true", help="print one JSON object per line"),
    CONNECT_TIMEOUT,
)
def run(args: argparse.Namespace) -> int:
    """List, show, check, remove or import the points in FILE. The arm never moves; `urlink teach --point` teaches a
    point. `check` reads the current TCP of a robot, and exits with 1 if the TCP does not reach a taught pose. `import`
    adds the fixed waypoints of a program that an e-Series controller has saved.

    examples:
      urlink points list cell.json
      urlink points show cell.json above_bin
      urlink points check cell.json 192.168.56.101
      urlink points check cell.json 192.168.56.101 above_bin --json
      urlink points remove cell.json above_bin
      urlink points import cell.json pick.urp --model UR5e
    """
    actions: dict[str, Callable[[PointFile, argparse.Namespace], int]] = {
        "list": _list,
        "show": _show,
        "check": _check,
        "remove": _remove,
        "import": _import,
    }
    return actions[args.action](PointFile(args.file), args)


def _list(file: PointFile, args: argparse.Namespace) -> int:
    if args.words:
        args.usage_error("list takes only FILE")
    for name, point in _existing(file).items():
        print(_as_json(name, point) if args.json else f"{name}: {point.model}, {point.date:%Y-%m-%d %H:%M} UTC")
    return 0


def _show(file: PointFile, args: argparse.Namespace) -> int:
    if not args.words:
        args.usage_error("show needs the names of points")
    _existing(file)
    for name in args.words:
        point = file.point(name)
        print(_as_json(name, point) if args.json else _as_text(name, point))
    return 0


def _check(file: PointFile, args: argparse.Namespace) -> int:
    if not args.words:
        args.usage_error("check needs the address of a robot")
    address, *names = args.words
    _existing(file)
    for name in names:
        file.point(name)  # raises before connecting if there is no such point
    with connected(args, address, read_only=True, points=args.file) as robot:
        checks = [each for each in robot.points.check_all() if not names or each.name in names]
    for each in checks:
        print(strict_json(_check_entries(each)) if args.json else _check_text(each))
    return 0 if all(each.is_reachable for each in checks) else 1


def _remove(file: PointFile, args: argparse.Namespace) -> int:
    if not args.words:
        args.usage_error("remove needs the names of points")
    _existing(file)
    removed = file.remove(tuple(args.words))
    for name, point in zip(args.words, removed, strict=True):
        print(_as_json(name, point) if args.json else f"removed {name}")
    return 0


def _import(file: PointFile, args: argparse.Namespace) -> int:
    if len(args.words) != 1 or args.model is None:
        args.usage_error("import needs one program (.urp) and --model ARM")
    points = read_waypoints(args.words[0], model(args.model))
    file.add(points, replace=args.replace)
    for name, point in points.items():
        print(_as_json(name, point) if args.json else f"imported {name}")
    return 0


def _existing(file: PointFile) -> dict[str, Point]:
    """Return the points of a file that exists, or raise `BadValue`."""
    if not file.path.exists():
        raise BadValue(f"{file.path} does not exist; `urlink teach --point NAME` creates it")
    return file.read()


def _as_json(name: str, point: Point) -> str:
    return strict_json({"name": name, **described(point)})


def _as_text(name: str, point: Point) -> str:
    rows = [f"{key}: {_shown(value)}" for key, value in described(point).items()]
    return "\n  ".join([name, *rows])


def _shown(value: Any) -> str:
    return printable(value) if isinstance(value, str) else " ".join(f"{each:.6f}" for each in value)


def _check_entries(check: PointCheck) -> dict[str, Any]:
    return {
        "name": check.name,
        "verdict": check.verdict,
        "reason": check.reason,
        "tcp_moved": check.moved,
        "tcp_turned": check.turned,
        "q": None if check.q is None else check.q.tolist(),
        "largest": check.largest,
    }


def _check_text(check: PointCheck) -> str:
    change = f"TCP changed by {check.moved * 1e3:.1f} mm and {math.degrees(check.turned):.1f} degrees"
    if check.verdict == "unchanged":
        return f"{check.name}: reachable, TCP unchanged"
    if check.verdict == "reachable":
        return f"{check.name}: reachable, {change}, largest joint motion {math.degrees(check.largest):.1f} degrees"
    return f"{check.name}: {check.verdict}, {printable(check.reason)}"

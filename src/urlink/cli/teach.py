"""`urlink teach`: saves waypoints while a person moves the arm by hand, and plays them."""

from __future__ import annotations

import argparse

from linkcore.cli.console import lines
from linkcore.cli.options import argument, command, one_of
from linkcore.cli.progress import ProgressBar
from linkcore.cli.terminal import Interruption
from linkcore.errors import BadValue

from ..motion.points.point_file import check_name
from ..motion.teaching import Taught, TaughtPoint
from ..robot import Robot
from .options import ADDRESS, LIMITS, connected
from .packet_fields import joints_text

#: Maximum time for playing the waypoints, in seconds.
_LONGEST = 3600.0


def _axes(text: str) -> list[int]:
    if len(text) != 6 or set(text) - {"0", "1"}:
        raise argparse.ArgumentTypeError(f"{text!r} is not six digits 0 or 1")
    return [int(each) for each in text]


@command(
    "teach",
    "teach waypoints by hand, and play them",
    *ADDRESS,
    LIMITS,
    argument("file", metavar="FILE", help="JSON file of the waypoints, or of the points with --point"),
    argument("--digital-input", type=int, metavar="N", help="standard digital input that also saves a waypoint"),
    argument("--button", action="store_true", help="move the arm with its own button; releasing it saves a waypoint"),
    argument("--axes", type=_axes, metavar="BITS", help="free axes x y z rx ry rz, such as 110001 (default: all)"),
    one_of(
        argument("--play", action="store_true", help="play FILE instead of teaching it"),
        argument("--point", metavar="NAME", help="teach one point with this name, and add it to the points in FILE"),
    ),
    argument("--replace", action="store_true", help="let --point replace a point that has this name"),
    argument("--speed", type=float, default=0.5, metavar="V", help="speed while playing, in rad/s (default: 0.5)"),
    argument("--blend", type=float, default=0.0, metavar="R", help="blend radius while playing, in m (default: 0)"),
)
def run(args: argparse.Namespace) -> int:
    """Save waypoints to FILE while a person moves the arm by hand. THE ARM YIELDS: it moves where it is pushed, and
    drifts if its payload is set incorrectly.

      Enter          save a waypoint
      u, Enter       delete the last waypoint
      q, Enter       write the waypoints to FILE and end; the end of stdin does the same

    Ctrl-C ends without saving. With --play, the arm moves through the waypoints of FILE instead. THE ARM MOVES. With
    --point, Enter saves the position of the arm as a point and ends; q ends without saving.

    examples:
      urlink teach 192.168.56.101 pick.json
      urlink teach 192.168.56.101 pick.json --digital-input 0
      urlink teach 192.168.56.101 pick.json --play --speed 0.3 --blend 0.02
      urlink teach 192.168.56.101 cell.json --point above_bin
    """
    known = Taught.load(args.file) if args.play else None
    if args.point is not None and (args.digital_input is not None or args.button):
        args.usage_error("--point saves with Enter; omit --digital-input and --button")
    points = args.file if args.point is not None else None
    with Interruption() as interruption, connected(args, points=points) as robot:
        if args.point is not None:
            return _teach_point(robot, args, interruption)
        if known is not None:
            with ProgressBar(f"playing {args.file}", args.quiet) as progress:
                _play(robot, known, args, interruption, progress)
        else:
            _keep(robot, args, interruption)
    return interruption.status


def _play(
    robot: Robot, taught: Taught, args: argparse.Namespace, interruption: Interruption, progress: ProgressBar
) -> None:
    with taught.play(robot, speed=args.speed, blend=args.blend) as motion:
        segment = -1
        while not motion.done and not interruption.wait(0.05):
            progress(motion.progress)
            if motion.segment != segment:
                segment = motion.segment
                print(f"to waypoint {segment + 1} of {len(taught)}", flush=True)
        if interruption.number is None:
            motion.wait(_LONGEST)
            print("done", flush=True)


def _teach_point(robot: Robot, args: argparse.Namespace, interruption: Interruption) -> int:
    """Teach one point, and return the exit status."""
    check_name(args.point)
    if args.point in robot.points and not args.replace:
        raise BadValue(f"{args.file} already has a point {args.point!r}; add --replace to replace it")
    with robot.freedrive(args.axes) as freedrive:
        print("move the arm; Enter saves the point, q ends", flush=True)
        for line in lines(lambda: interruption.number is None):
            if freedrive.done:
                freedrive.wait(0.0)
            if line == "":
                point = robot.points.teach(args.point, replace=args.replace)
                print(f"{args.point} in {args.file}: {joints_text(point.q)}", flush=True)
                return 0
            if line == "q":
                break
            if line is not None:
                print("Enter saves the point, q ends", flush=True)
    if interruption.number is None:
        raise BadValue("the point was not taught, so nothing was saved")
    return interruption.status


def _keep(robot: Robot, args: argparse.Namespace, interruption: Interruption) -> None:
    with robot.teach(digital_input=args.digital_input, button=args.button, axes=args.axes, on_point=_show) as teaching:
        print("move the arm; Enter saves a waypoint, q ends", flush=True)
        for line in lines(lambda: interruption.number is None):
            if teaching.freedrive is not None and teaching.freedrive.done:
                teaching.freedrive.wait(0.0)
            if line == "":
                teaching.record()
            elif line == "u":
                teaching.taught.remove_last()
                print(f"{len(teaching.taught)} waypoints", flush=True)
            elif line == "q":
                break
            elif line is not None:
                print("Enter saves a waypoint, u deletes the last one, q ends", flush=True)
    if interruption.number is None:
        if not len(teaching.taught):
            raise BadValue("no waypoint was taught, so nothing was saved")
        teaching.taught.save(args.file)
        print(f"{len(teaching.taught)} waypoints in {args.file}", flush=True)


def _show(point: TaughtPoint) -> None:
    print(joints_text(point.q), flush=True)

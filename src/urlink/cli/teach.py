"""`urlink teach`: save waypoints while a person moves the arm by hand, and play them."""

from __future__ import annotations

import argparse
import os
import select
import sys
from collections.abc import Iterator

from linkcore.cli.program import Interruption
from linkcore.errors import BadValue, LocalError

from ..motion.taught import Taught, TaughtPoint
from ..robot import Robot, connect
from .options import Subparsers, add_address, add_command

__all__ = ["add_parser"]

_DESCRIPTION = """\
Save waypoints to FILE while a person moves the arm by hand. THE ARM YIELDS: it goes where it is pushed,
and drifts if its payload is set wrong.

  Enter          keeps a waypoint
  u, Enter       forgets the last one
  q, Enter       saves them, and ends; so does the end of stdin

Ctrl-C ends without saving. With --play the arm moves through the waypoints of FILE instead. THE ARM MOVES."""

_EXAMPLES = (
    "urlink teach 192.168.56.101 pick.json",
    "urlink teach 192.168.56.101 pick.json --digital-input 0",
    "urlink teach 192.168.56.101 pick.json --play --speed 0.3 --blend 0.02",
)

#: Seconds that playing may take.
_LONGEST = 3600.0


def add_parser(subparsers: Subparsers) -> None:
    """Declare the command."""
    parser = add_command(subparsers, "teach", "teach waypoints by hand, and play them", _DESCRIPTION, _EXAMPLES)
    add_address(parser)
    parser.add_argument("file", metavar="FILE", help="file of the waypoints, in JSON")
    parser.add_argument("--digital-input", type=int, metavar="N", help="standard digital input that keeps one too")
    parser.add_argument("--button", action="store_true", help="move it by the arm's own button; releasing it keeps one")
    parser.add_argument("--axes", type=_axes, metavar="BITS", help="free axes x y z rx ry rz, such as 110001 (all)")
    parser.add_argument("--play", action="store_true", help="play FILE instead of teaching it")
    parser.add_argument("--speed", type=float, default=0.5, metavar="V", help="rad/s while playing (0.5)")
    parser.add_argument("--blend", type=float, default=0.0, metavar="R", help="m of round corners while playing (0)")
    parser.set_defaults(run=run)


def _axes(text: str) -> list[int]:
    if len(text) != 6 or set(text) - {"0", "1"}:
        raise argparse.ArgumentTypeError(f"{text!r} is not six of 0 and 1")
    return [int(each) for each in text]


def run(args: argparse.Namespace) -> int:
    """Teach, or play.

    Raises:
        BadValue: the file, or a number, is invalid.
        LinkError: the error that ended it.
    """
    known = Taught.load(args.file) if args.play else None
    with Interruption() as interruption, connect(args.address, timeout=args.connect_timeout) as robot:
        if known is not None:
            _play(robot, known, args, interruption)
        else:
            _teach(robot, args, interruption)
    interruption.raise_if_any()
    return 0


def _play(robot: Robot, taught: Taught, args: argparse.Namespace, interruption: Interruption) -> None:
    with taught.play(robot, speed=args.speed, blend=args.blend) as motion:
        segment = -1
        while not motion.done and not interruption.wait(0.05):
            if motion.segment != segment:
                segment = motion.segment
                print(f"to waypoint {segment + 1} of {len(taught)}", flush=True)
        if interruption.number is None:
            motion.wait(_LONGEST)
            print("done", flush=True)


def _teach(robot: Robot, args: argparse.Namespace, interruption: Interruption) -> None:
    teaching = robot.teach(digital_input=args.digital_input, button=args.button, axes=args.axes, on_point=_show)
    with teaching:
        print("move the arm; Enter keeps a waypoint, q ends", flush=True)
        for line in _lines(interruption):
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
                print("Enter keeps a waypoint, u forgets the last, q ends", flush=True)
    if interruption.number is None:
        if not len(teaching.taught):
            raise BadValue("no waypoint was taught, so nothing was saved")
        teaching.taught.save(args.file)
        print(f"{len(teaching.taught)} waypoints in {args.file}", flush=True)


def _show(point: TaughtPoint) -> None:
    print(f"q: {', '.join(f'{each:.4f}' for each in point.q.tolist())}", flush=True)


def _lines(interruption: Interruption) -> Iterator[str | None]:
    """Lines of stdin without line ends, until it ends or a signal comes; None while there is no line.

    Raises:
        LocalError: this system cannot wait for stdin with a timeout.
    """
    held = b""
    while interruption.number is None:
        try:
            is_ready = bool(select.select([sys.stdin], [], [], 0.05)[0])
        except (OSError, ValueError) as error:
            raise LocalError(f"stdin cannot be waited for: {error}") from None
        if not is_ready:
            yield None
            continue
        read = os.read(sys.stdin.fileno(), 1024)
        held += read
        *lines, held = held.split(b"\n")
        for line in lines:
            yield line.decode(errors="replace").strip()
        if not read:
            return

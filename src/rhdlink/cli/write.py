"""`rhdlink set`: write a variable as the robot's master."""

from __future__ import annotations

import argparse
import re
import time

from linkcore.cli.interruption import Interruption
from linkcore.cli.options import Subparsers, add_command, seconds

from ..client import connect
from .meaning import in_units, words_text
from .options import add_address, tell

__all__ = ["add_parser"]

_DESCRIPTION = """\
Write a variable, as the master of the robot. A robot has one master at a time: while another program is
it, this fails.

VALUEs are the words of the variable as they are on the wire, whole numbers of 32 bits, as many as it is
long: 30000, and not 0.3 m/s. Many robots stop when their master leaves, which this does at once unless
--hold says how long to stay; Ctrl-C ends that earlier. THIS MOVES A REAL ROBOT."""

_EXAMPLES = (
    "rhdlink set localhost cmdtransvel 30000 --hold 2",
    "rhdlink set smr12 speedl 10 --hold 1",
    "rhdlink set localhost cmdrotvel -- -20000",
)


def add_parser(subparsers: Subparsers) -> None:
    """Declare the command."""
    parser = add_command(subparsers, "set", "write a variable, as master", _DESCRIPTION, _EXAMPLES)
    add_address(parser)
    parser.add_argument("name", metavar="NAME", help="a write variable of the robot")
    parser.add_argument("values", metavar="VALUE", nargs="+", type=_word, help="its words")
    parser.add_argument("--hold", type=seconds, metavar="S", help="stay master for S seconds (leave at once)")
    parser.set_defaults(run=run)


def _word(text: str) -> int:
    if not re.fullmatch(r"[+-]?[0-9]{1,10}", text) or not -(2**31) <= int(text) < 2**31:
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number of 32 bits")
    return int(text)


def run(args: argparse.Namespace) -> int:
    """Write it, and stay as long as told.

    Raises:
        NotThere: the robot has no such write variable.
        BadValue: not as many words as it is long.
        AccessDenied: it has a master already.
        RemoteError: nobody is there, or no longer.
    """
    with connect(args.address, access="w", timeout=args.timeout) as robot, Interruption() as interruption:
        robot[args.name] = args.values if len(args.values) > 1 else args.values[0]
        robot.sync()  # the answer says that it was taken
        (words,) = (each.value for each in robot.variables if (each.direction, each.name) == ("w", args.name))
        meaning = in_units("w", args.name, words)
        tell(f"{args.name} is {words_text(words)}" + (f" = {meaning}" if meaning else ""))
        if args.hold is not None:
            until = time.monotonic() + args.hold
            while interruption.number is None and time.monotonic() < until:
                robot.sync()
    interruption.raise_if_any()
    return 0

"""`rhdlink set`: write a variable, as master of the robot."""

from __future__ import annotations

import argparse
import re

from linkcore import clock
from linkcore.cli.options import argument, command, seconds
from linkcore.cli.progress import ProgressBar
from linkcore.cli.terminal import Interruption

from .options import ADDRESS, connected, tell
from .variable_text import with_meaning, words_of


def _word(text: str) -> int:
    if not re.fullmatch(r"[+-]?[0-9]{1,10}", text) or not -(2**31) <= int(text) < 2**31:
        raise argparse.ArgumentTypeError(f"{text!r} is not a 32-bit integer")
    return int(text)


@command(
    "set",
    "write a variable, as master",
    *ADDRESS,
    argument("name", metavar="NAME", help="a write variable of the robot"),
    argument("values", metavar="VALUE", nargs="+", type=_word, help="words of the variable"),
    argument("--hold", type=seconds, metavar="S", help="stay master for S seconds (default: leave immediately)"),
)
def run(args: argparse.Namespace) -> int:
    """Write a variable, as the master of the robot. A robot has one master at a time, so this command fails while
    another program is master.

    VALUEs are the words of the variable as they are on the wire: 32-bit integers, one for each word, for example
    30000 instead of 0.3 m/s. Many robots stop when their master leaves. This command leaves immediately, unless --hold
    gives a time to stay. Ctrl-C ends this time earlier. THIS MOVES A REAL ROBOT.

    examples:
      rhdlink set localhost cmdtransvel 30000 --hold 2
      rhdlink set smr12 speedl 10 --hold 1
      rhdlink set localhost cmdrotvel -- -20000
    """
    with connected(args, access="w") as robot, Interruption() as interruption:
        robot[args.name] = args.values if len(args.values) > 1 else args.values[0]
        robot.sync()  # the reply confirms the write
        (value,) = (each.value for each in robot.variables if (each.direction, each.name) == ("w", args.name))
        tell(f"{args.name} is {with_meaning('w', args.name, words_of(value))}")
        if args.hold is not None:
            interruption.end_after(args.hold)
            begun = clock.now()
            with ProgressBar(f"holding {args.name}", args.quiet) as progress:
                while not interruption.is_over:
                    robot.sync()
                    progress((clock.now() - begun) / args.hold)
    return interruption.status

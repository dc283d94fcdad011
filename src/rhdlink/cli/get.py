"""`rhdlink get`: print the values of variables."""

from __future__ import annotations

import argparse

from linkcore.cli.options import argument, command
from linkcore.text import printable, strict_json

from .options import ADDRESS, connected
from .variable_text import TYPES, as_json, check_names, typed, with_meaning, words_of


@command(
    "get",
    "print the values of variables",
    *ADDRESS,
    argument("names", metavar="NAME", nargs="+", help="a variable of the robot", trailing=True),
    argument("--as", dest="type", choices=tuple(TYPES), help="decode the words as values of this type"),
    argument(
        "--order", choices=("little", "big"), default="little", help="order of values of two words (default: little)"
    ),
    argument("--json", action="store_true", help="print one JSON object per line, for each variable"),
)
def run(args: argparse.Namespace) -> int:
    """Print the values of variables, one per line, in the given order.

    The words are printed first, as they are on the wire. Their meaning follows after `=` if the name has a
    conventional meaning. If a read and a write variable have the same name, the read variable is printed.

    With --as, the words are decoded as values of a type, and only these values are printed.

    examples:
      rhdlink get localhost tick
      rhdlink get smr12 encl encr linesensor
      rhdlink get localhost transpos rotpos --json
      rhdlink get localhost bearing --as float64
    """
    with connected(args) as robot:
        by_name = {variable.name: variable for variable in reversed(robot.variables)}
        check_names(args.names, by_name, robot.address)
        for name in args.names:
            variable = by_name[name]
            words = words_of(variable.value)
            values = None if args.type is None else typed(name, words, args.type, args.order)
            if args.json:
                print(strict_json(as_json(variable) | ({} if values is None else {"values": values})))
                continue
            if values is not None:
                print(f"{printable(name)} {' '.join(map(repr, values))}")
                continue
            print(f"{printable(name)} {with_meaning(variable.direction, name, words, None)}")
    return 0

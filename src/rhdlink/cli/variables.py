"""`rhdlink vars`: what a robot has."""

from __future__ import annotations

import argparse

from linkcore.cli.options import Subparsers, add_command
from linkcore.cli.terminal import safe, strict_json

from ..client import connect
from .meaning import as_columns, as_json
from .options import add_address

__all__ = ["add_parser"]

_DESCRIPTION = """\
List the variables of a robot: direction, id, name, words, meaning, and when each was set.

`read` variables go from the robot to programs, `write` variables from programs to the robot. A robot tells
the name and the length of a variable and nothing else; the meaning after the `=` is that which the name has
by convention. A time of 0 says that a variable was never set."""

_EXAMPLES = (
    "rhdlink vars localhost",
    "rhdlink vars smr12:24902 --json",
    "rhdlink vars localhost --json | jq -r .name",
)


def add_parser(subparsers: Subparsers) -> None:
    """Declare the command."""
    parser = add_command(subparsers, "vars", "list the variables of a robot", _DESCRIPTION, _EXAMPLES)
    add_address(parser)
    parser.add_argument("--json", action="store_true", help="one JSON object a line, for each variable")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """List them.

    Raises:
        RemoteError: nobody is there.
    """
    with connect(args.address, timeout=args.timeout) as robot:
        # What came with the handshake is the newest there is.
        found = robot.variables
        if args.json:
            for variable in found:
                print(strict_json(as_json(variable)))
            return 0
        print(safe(f"{robot.address}: {len(found)} variables, time stamps of {robot.width} words"))
        rows = [as_columns(variable) for variable in found]
        widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
        # A long array does not push the columns after it off the screen.
        widths[3] = min(widths[3], 40)
        for row in rows:
            print("  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip())
    return 0

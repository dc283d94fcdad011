"""`rhdlink get`: the values of some variables, once."""

from __future__ import annotations

import argparse

from linkcore.cli.options import Subparsers, add_command
from linkcore.cli.terminal import safe, strict_json

from ..client import connect
from ..errors import NotThere
from .meaning import as_json, in_units, words_text
from .options import add_address

__all__ = ["add_parser"]

_DESCRIPTION = """\
Print the values of variables, one line each, in the order in which they are named.

The words come first, as they are on the wire; after the `=` stands what they mean, where the name has a
meaning by convention. Of a read and a write variable with the same name it is the read variable."""

_EXAMPLES = (
    "rhdlink get localhost tick",
    "rhdlink get smr12 encl encr linesensor",
    "rhdlink get localhost transpos rotpos --json",
)


def add_parser(subparsers: Subparsers) -> None:
    """Declare the command."""
    parser = add_command(subparsers, "get", "print the values of variables", _DESCRIPTION, _EXAMPLES)
    add_address(parser)
    parser.add_argument("names", metavar="NAME", nargs="+", help="a variable of the robot")
    parser.add_argument("--json", action="store_true", help="one JSON object a line, for each variable")
    parser.set_defaults(run=run, trailing="names")


def run(args: argparse.Namespace) -> int:
    """Print them.

    Raises:
        NotThere: the robot has no such variable.
        RemoteError: nobody is there.
    """
    with connect(args.address, timeout=args.timeout) as robot:
        by_name = {variable.name: variable for variable in reversed(robot.variables)}
        missing = [name for name in args.names if name not in by_name]
        if missing:
            raise NotThere(f"{robot.address} has no variable {', '.join(map(repr, missing))}; `rhdlink vars` lists all")
        for name in args.names:
            variable = by_name[name]
            if args.json:
                print(strict_json(as_json(variable)))
                continue
            meaning = in_units(variable.direction, name, variable.value)
            print(f"{safe(name)} {words_text(variable.value, None)}" + (f" = {meaning}" if meaning else ""))
    return 0

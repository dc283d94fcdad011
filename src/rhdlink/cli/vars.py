"""`rhdlink vars`: list the variables of a robot."""

from __future__ import annotations

import argparse

from linkcore.cli.options import argument, command
from linkcore.text import printable, strict_json

from .options import ADDRESS, connected
from .variable_text import as_columns, as_json


@command(
    "vars",
    "list the variables of a robot",
    *ADDRESS,
    argument("--json", action="store_true", help="print one JSON object per line, for each variable"),
)
def run(args: argparse.Namespace) -> int:
    """List the variables of a robot: direction, id, name, words, meaning, and time stamp.

    `read` variables go from the robot to programs, and `write` variables go from programs to the robot. A robot sends
    only the name and the length of a variable. The meaning after `=` is the conventional meaning of the name. A time
    of 0 means that a variable was never set.

    examples:
      rhdlink vars localhost
      rhdlink vars smr12:24902 --json
      rhdlink vars localhost --json | jq -r .name
    """
    with connected(args) as robot:
        # The values of the handshake are the newest values.
        found = robot.variables
        if args.json:
            for variable in found:
                print(strict_json(as_json(variable)))
            return 0
        print(printable(f"{robot.address}: {len(found)} variables, time stamps of {robot.width} words"))
        if not found:
            return 0  # without variables there are no columns
        rows = [as_columns(variable) for variable in found]
        widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
        # A long array must not push the columns after it off the screen.
        widths[3] = min(widths[3], 40)
        for row in rows:
            print("  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip())
    return 0
